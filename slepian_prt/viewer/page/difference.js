/** The scale of differences: |a - b|, mean of the colours, in parts of the mean radiance. */

import { colourGradient } from "#colours";
import { sideNames } from "#divider";
import { radianceOfVertices } from "#radiance";

const STEPS = [1, 2, 5, 10, 20, 50, 100];
const VERTICES = 20000;

/** Mean radiance of the left side, and the part of it (in %) that 99 % of the vertices differ less than. */
export function measureDifference([one, two]) {
  const count = one.model.bytes.length / one.model.functions;
  const isSame = two.model.bytes.length / two.model.functions === count;
  const left = radianceOfVertices(one.model, one.lit);
  const mean = left.reduce((sum, value) => sum + Math.max(value, 0), 0) / left.length;
  if (!isSame || !(mean > 0)) return { mean, percent: 10 };
  const right = radianceOfVertices(two.model, two.lit);
  const apart = [];
  const step = Math.max(1, Math.floor(count / VERTICES));
  for (let i = 0; i < 3 * count; i += 3 * step) {
    let sum = 0;
    for (let c = 0; c < 3; ++c) sum += Math.abs(left[i + c] - right[i + c]);
    apart.push(sum / 3);
  }
  apart.sort((a, b) => a - b);
  return { mean, percent: (100 * apart[Math.floor(0.99 * apart.length)]) / mean };
}

/** Keep the scale, and its legend, as the state is. */
export function bindDifference(viewer) {
  const { state, payload } = viewer;
  const [legend, title, largest] = ["legend", "legend-title", "legend-largest"].map((id) => document.getElementById(id));
  legend.querySelector(".scale").style.background = colourGradient();
  const show = () => {
    const { mode, percent, compare, functions } = state.values;
    legend.hidden = mode !== "difference";
    if (mode !== "difference") return;
    const measured = measureDifference(viewer.sides);
    const most = percent || (STEPS.find((step) => step >= measured.percent) ?? 100);
    viewer.largest = Math.max((most / 100) * measured.mean, 1e-30);
    const [left, right] = sideNames(payload, compare, functions);
    title.textContent = `${left} against ${right}, in parts of the mean radiance`;
    largest.textContent = `${most} %`;
  };
  state.listen(show);
  show();
}
