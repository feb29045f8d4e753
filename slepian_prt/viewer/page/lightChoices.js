/** The list of lights, each with a small picture of its map. */

import { mapOf } from "#lights";

const WIDTH = 144;

/** Fill the list; pictures come when there is time. */
export function fillLights(viewer) {
  viewer.lights.forEach((light, i) => addLightChoice(viewer, light, i));
  viewer.state.listen((names) => { if (names.has("light")) follow(viewer); });
}

/** One more light. */
export function addLightChoice(viewer, light, index) {
  const { state } = viewer;
  const label = document.createElement("label");
  const input = Object.assign(document.createElement("input"), { type: "radio", name: "light", value: String(index) });
  const name = Object.assign(document.createElement("span"), { className: "name", textContent: light.name });
  const blank = Object.assign(document.createElement("span"), { className: "blank" });
  label.title = light.name;
  label.append(input, blank, name);
  input.addEventListener("change", () => state.set({ light: index }));
  document.getElementById("lights").append(label);
  follow(viewer);
  if (!light.bytes && !light.map) return;
  blank.classList.add("coming");
  whenIdle(async () => blank.replaceWith(thumbnail(await mapOf(light))));
}

function follow({ state }) {
  for (const input of document.querySelectorAll("#lights input")) input.checked = +input.value === state.values.light;
}

const whenIdle = (work) => (globalThis.requestIdleCallback ?? ((run) => setTimeout(run, 200)))(work, { timeout: 4000 });

/** A map as a small picture, exposed for its mean. */
function thumbnail({ width, height, data }) {
  const canvas = Object.assign(document.createElement("canvas"), { width: WIDTH, height: WIDTH / 2 });
  const context = canvas.getContext("2d");
  const picture = context.createImageData(WIDTH, WIDTH / 2);
  const colours = new Float32Array((3 * WIDTH * WIDTH) / 2);
  for (let i = 0; i < colours.length / 3; ++i) {
    const row = Math.floor(((Math.floor(i / WIDTH) + 0.5) * height) / (WIDTH / 2));
    const column = Math.floor((((i % WIDTH) + 0.5) * width) / WIDTH);
    colours.set(data.subarray(3 * (row * width + column), 3 * (row * width + column) + 3), 3 * i);
  }
  const sorted = Float32Array.from(colours).sort();
  const scale = 0.7 / Math.max(sorted[Math.floor(0.85 * sorted.length)], 1e-30);
  for (let i = 0; i < colours.length; ++i) {
    const shown = Math.min(1, Math.max(0, scale * colours[i])) ** (1 / 2.2);
    picture.data[4 * Math.floor(i / 3) + (i % 3)] = 255 * shown;
    picture.data[4 * Math.floor(i / 3) + 3] = 255;
  }
  context.putImageData(picture, 0, 0);
  canvas.setAttribute("aria-hidden", "true");
  return canvas;
}
