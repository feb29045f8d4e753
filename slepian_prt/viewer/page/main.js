/** The page: reads what it holds, draws it, and then makes its controls. */

import { bindDifference } from "#difference";
import { bindDivider } from "#divider";
import { bindDrop } from "#drop";
import { bindKeyboard, fillKeys } from "#keyboard";
import { lightsOf } from "#lights";
import { decodeTextures } from "#model";
import { watchNegative } from "#negative";
import { notify, stopWith } from "#notices";
import { bindPanel, cover } from "#panel";
import { readPayload } from "#payload";
import { bindPointer } from "#pointer";
import { copyLink, savePicture } from "#saving";
import { bindHash, firstValues, hashOf, State } from "#state";
import { Viewer } from "#viewer";

const timings = { modules: performance.now() };

/** Colours of the page that the picture shares. */
function followScheme(viewer) {
  const isDark = matchMedia("(prefers-color-scheme: dark)");
  const follow = () => {
    viewer.colours = isDark.matches
      ? { plain: "#17181a", light: 0.3, dark: 0.25 }
      : { plain: "#f2f2f3", light: 0.94, dark: 0.86 };
    viewer.redraw();
  };
  isDark.addEventListener("change", follow);
  follow();
}

/** Keep the canvas as large as the window, in its own pixels. */
function followSize(viewer) {
  const { canvas } = viewer;
  const follow = () => {
    const ratio = Math.min(devicePixelRatio, 2);
    viewer.pixels = [canvas.clientWidth, canvas.clientHeight].map((size) => Math.max(2, Math.round(size * ratio)));
    cover(viewer);
  };
  new ResizeObserver(follow).observe(canvas);
  follow();
}

function actionsOf(viewer) {
  const { state } = viewer;
  const dialog = document.getElementById("keys");
  return {
    auto: () => state.set({ exposure: Math.min(6, Math.max(-6, viewer.measureStops())) }),
    home: () => state.set({ eye: null, target: null }),
    save: () => savePicture(viewer).catch((error) => notify(`The picture could not be saved: ${error.message}.`)),
    link: () => copyLink(hashOf(state, viewer.lights), notify),
    help: () => dialog.showModal(),
    open: () => document.getElementById("file").click(),
  };
}

/** What takes no part in the first picture. */
function addControls(viewer) {
  const { payload } = viewer;
  const actions = actionsOf(viewer);
  const { addLight } = bindPanel(viewer, actions);
  const drop = bindDrop(viewer, addLight, notify);
  bindDivider(viewer);
  bindDifference(viewer);
  bindKeyboard(viewer, actions);
  fillKeys();
  watchNegative(viewer);
  if (payload.camera?.locked) notify("This is light toward the file's camera: it is drawn from there only.");
  return drop;
}

function waitForPicture(viewer) {
  return new Promise((resolve) => { viewer.listen(resolve); });
}

async function start() {
  const payload = await readPayload(document.getElementById("payload").textContent);
  timings.payload = performance.now();
  const canvas = document.getElementById("canvas");
  canvas.setAttribute("aria-label", `Picture of ${payload.title}`);
  const lights = lightsOf(payload);
  const state = new State(firstValues(payload));
  bindHash(state, lights, notify);
  const viewer = new Viewer(canvas, payload, state, lights, await decodeTextures(payload.textures));
  timings.viewer = performance.now();
  canvas.addEventListener("webglcontextlost", (event) => {
    event.preventDefault();
    viewer.isLost = true;
    stopWith("The graphics driver took the picture away; reload the page to see it again.");
  });
  document.getElementById("message").hidden = true;
  document.getElementById("panel").hidden = false;
  bindPointer(viewer, () => Boolean(payload.film) || document.getElementById("drag").checked);
  followScheme(viewer);
  followSize(viewer);
  const first = waitForPicture(viewer);
  await first;
  timings.firstLight = performance.now();
  const drop = addControls(viewer);
  return { payload, viewer, state, drop };
}

/**
 * For tests, and for whoever writes on the console: what is drawn, and how long it took.
 */
globalThis.slepianPrt = { timings, ready: start() };
await globalThis.slepianPrt.ready;
