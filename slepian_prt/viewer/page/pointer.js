/** Turning the light with the pointer: with shift or alt held, where a switch says so, and always on films. */

const DEGREES_PER_PIXEL = 0.4;

/** Degrees in -180 … 180. */
export const wrapped = (degrees) => ((((degrees + 180) % 360) + 360) % 360) - 180;

const limited = (degrees) => Math.min(90, Math.max(-90, degrees));

/**
 * Listen to drags on the canvas.
 *
 * @param {import("#viewer").Viewer} viewer
 * @param {() => boolean} always - Whether a drag without a key turns the light too.
 */
export function bindPointer(viewer, always) {
  const { canvas, state } = viewer;
  let from = null;
  const wants = (event) => event.button === 0 && (event.shiftKey || event.altKey || always());
  canvas.addEventListener("pointerdown", (event) => {
    if (!wants(event) || !event.isPrimary) return;
    event.stopImmediatePropagation(); // before OrbitControls, which listens later
    canvas.setPointerCapture(event.pointerId);
    canvas.classList.add("turning");
    from = { id: event.pointerId, x: event.clientX, y: event.clientY, ...state.values };
  }, { capture: true });
  canvas.addEventListener("pointermove", (event) => {
    if (from === null || event.pointerId !== from.id) return;
    event.stopImmediatePropagation();
    state.set({
      turn: wrapped(from.turn + DEGREES_PER_PIXEL * (event.clientX - from.x)),
      tilt: limited(from.tilt + DEGREES_PER_PIXEL * (event.clientY - from.y)),
    });
  }, { capture: true });
  const end = (event) => {
    if (from === null || event.pointerId !== from.id) return;
    event.stopImmediatePropagation();
    canvas.classList.remove("turning");
    from = null;
  };
  canvas.addEventListener("pointerup", end, { capture: true });
  canvas.addEventListener("pointercancel", end, { capture: true });
}

/** Change the turn of the light by degrees. */
export function turnBy(state, degrees) {
  state.set({ turn: wrapped(state.values.turn + degrees) });
}

/** Change its tilt. */
export function tiltBy(state, degrees) {
  state.set({ tilt: limited(state.values.tilt + degrees) });
}
