/** How many vertices are negative under the light, and the window that damps them: worked out when nothing moves. */

import { coefficientsOf } from "#lights";
import { countedVertices, dampLight, negativeFraction } from "#radiance";

const PAUSE = 200;
const WATCHED = ["light", "turn", "tilt", "functions", "window"];

const percent = (part) => (part === 0 ? "none" : part < 0.0005 ? "< 0.1 %" : `${(100 * part).toFixed(1)} %`);

/** Keep the count and the width of the window as the light is. */
export function watchNegative(viewer) {
  const { payload, state } = viewer;
  const [model] = payload.models;
  const geometry = payload.geometries[model.geometry];
  let options = null;
  let timer = 0;
  let latest = 0;
  const output = document.getElementById("negative");
  const measure = async () => {
    latest += 1;
    const mine = latest;
    options ??= { reflectance: geometry?.reflectance, counted: countedVertices(geometry?.receivers) };
    const { values } = state;
    if (values.window) {
      const plain = coefficientsOf(viewer.light, values, payload);
      const { width } = await dampLight(model, plain, payload.window.name, options);
      if (mine !== latest) return;
      if (width !== viewer.width) {
        viewer.width = width;
        viewer.redraw({ light: true });
      }
    }
    const part = await negativeFraction(model, viewer.sides[0].lit, options);
    if (mine === latest) output.textContent = percent(part);
  };
  const later = () => {
    clearTimeout(timer);
    timer = setTimeout(measure, PAUSE);
  };
  state.listen((names) => { if (WATCHED.some((name) => names.has(name))) later(); });
  later();
}
