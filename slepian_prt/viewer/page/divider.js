/** The divider between two pictures: dragged, or moved with the arrow keys. */

const clamp = (value) => Math.min(1, Math.max(0, value));

/** Tie the divider to the state. */
export function bindDivider({ state, payload, listen }, divider = document.getElementById("divider")) {
  void listen;
  const [left, right] = ["left-label", "right-label"].map((id) => document.getElementById(id));
  const show = () => {
    const { mode, split, compare, functions } = state.values;
    divider.hidden = mode !== "split";
    divider.style.left = `${100 * split}%`;
    divider.setAttribute("aria-valuenow", String(Math.round(100 * split)));
    [left.textContent, right.textContent] = sideNames(payload, compare, functions);
    divider.setAttribute("aria-valuetext", `${Math.round(100 * split)} % ${left.textContent}`);
  };
  divider.addEventListener("pointerdown", (event) => {
    divider.setPointerCapture(event.pointerId);
    event.preventDefault();
    divider.focus({ focusVisible: false });
  });
  divider.addEventListener("pointermove", (event) => {
    if (divider.hasPointerCapture(event.pointerId)) state.set({ split: clamp(event.clientX / innerWidth) });
  });
  divider.addEventListener("keydown", (event) => {
    const step = event.shiftKey ? 0.1 : 0.01;
    const to = {
      ArrowLeft: state.values.split - step, ArrowDown: state.values.split - step,
      ArrowRight: state.values.split + step, ArrowUp: state.values.split + step, Home: 0, End: 1,
    }[event.key];
    if (to === undefined) return;
    event.preventDefault();
    event.stopPropagation();
    state.set({ split: clamp(to) });
  });
  state.listen(show);
  show();
}

/** What stands left and right. */
export function sideNames({ models }, compare, functions) {
  const [first, second] = models;
  if (compare === "model" && second) {
    const fewer = functions < first.functions ? `, ${functions} functions` : "";
    return [first.label + fewer, second.label];
  }
  return [`${functions} function${functions === 1 ? "" : "s"}`, `all ${first.functions}`];
}
