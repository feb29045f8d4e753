/** Keys of the page, and the dialog that lists them. */

import { tiltBy, turnBy } from "#pointer";

const ORBIT = Math.PI / 36;
const MODES = ["picture", "split", "difference", "caps"];

const LIST = [
  ["Drag, one finger", "orbit"],
  ["Right drag, two fingers", "move the picture"],
  ["Wheel, pinch, + −", "zoom"],
  ["← → ↑ ↓", "orbit"],
  ["Shift or Alt and drag, Shift ← → ↑ ↓", "turn and tilt the light"],
  ["L", "the next light"],
  ["W", "window against ringing"],
  ["1 2 3 4", "picture, split, difference, caps"],
  [", .", "fewer or more functions"],
  ["E  Shift E", "brighter, darker"],
  ["A", "expose what is seen now"],
  ["B", "background"],
  ["0", "the camera of the file"],
  ["O", "open a map"],
  ["S", "save the picture"],
  ["C", "copy a link to this view"],
  ["P", "hide or show the settings"],
  ["?", "this list"],
];

/** What each key does; `actions` are those of the buttons. */
function keysOf(viewer, actions) {
  const { state, payload, lights } = viewer;
  const { values } = state;
  const count = payload.models[0].functions;
  const orbit = (right, up) => {
    if (!viewer.controls?.enabled) return;
    viewer.controls.rotateLeft(-right * ORBIT);
    viewer.controls.rotateUp(-up * ORBIT);
  };
  const zoom = (by) => { if (viewer.controls?.enabled) viewer.controls.dollyIn(by); };
  const arrows = (right, up) => (event) => {
    if (!event.shiftKey && !payload.film) return orbit(right, up);
    if (right) return turnBy(state, 5 * right);
    return tiltBy(state, -5 * up);
  };
  const expose = (event) => {
    const stops = values.exposure + (event.shiftKey ? -0.25 : 0.25);
    state.set({ exposure: Math.min(6, Math.max(-6, stops)) });
  };
  const backgrounds = [...(lights.some(({ bytes, map }) => bytes || map) ? ["map"] : []), "#ffffff", "transparent"];
  return {
    ArrowLeft: arrows(-1, 0), ArrowRight: arrows(1, 0), ArrowUp: arrows(0, 1), ArrowDown: arrows(0, -1),
    "+": () => zoom(1 / 0.9), "=": () => zoom(1 / 0.9), "-": () => zoom(0.9),
    l: () => state.set({ light: (values.light + 1) % lights.length }),
    w: () => state.set({ window: !values.window }),
    ...Object.fromEntries(MODES.map((mode, i) => [String(i + 1), () => state.set({ mode })])),
    ",": () => state.set({ functions: Math.max(1, values.functions - 1) }),
    ".": () => state.set({ functions: Math.min(count, values.functions + 1) }),
    e: expose,
    b: () => state.set({ background: backgrounds[(backgrounds.indexOf(values.background) + 1) % backgrounds.length] }),
    a: actions.auto, 0: actions.home, o: actions.open, s: actions.save, c: actions.link, "?": actions.help,
    p: () => document.getElementById("fold").click(),
  };
}

/** Listen to keys, but for those of controls that are in focus. */
export function bindKeyboard(viewer, actions) {
  const keys = keysOf(viewer, actions);
  addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.metaKey || event.altKey || document.querySelector("dialog[open]")) return;
    const { target } = event;
    const isArrow = event.key.startsWith("Arrow");
    if (target.matches("select, input[type=color], input[type=text]")) return;
    if (target.matches("input, summary") && (isArrow || event.key === " ")) return;
    if (isArrow && target.closest("#settings")) return;
    const action = keys[event.key.length === 1 ? event.key.toLowerCase() : event.key];
    if (action === undefined) return;
    event.preventDefault();
    action(event);
  });
}

/** Fill the dialog. */
export function fillKeys(dialog = document.getElementById("keys")) {
  const list = dialog.querySelector("dl");
  for (const [keys, text] of LIST) {
    const [term, description] = ["dt", "dd"].map((tag) => document.createElement(tag));
    const key = document.createElement("kbd");
    key.textContent = keys;
    term.append(key);
    description.textContent = text;
    list.append(term, description);
  }
}
