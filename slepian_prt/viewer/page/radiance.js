// Radiance of vertices on the processor, how many are negative, and the window that leaves hardly any, as Python's
// relighting/relight.py and relighting/damping.py have it.

import { damped, windowFactors } from "#harmonics";
import { lightFunctions } from "#light";
import { inPieces } from "#tasks";

// Sampling noise, relative to the largest radiance: what is negative by less does not count.
const NOISE = 0.01;

// Widths that are searched: up to this many times the bandlimit, so many of them in each round.
const WIDEST = 16, WIDTHS = 12;

// Fraction of the receivers that may stay negative: to leave none costs several times the change.
const LEFT_NEGATIVE = 1e-3;

// Vertices of a piece of work.
const PIECE = 4096;

/**
 * Radiance of vertices of unit albedo, without lamps.
 *
 * @param {{functions: number, bytes: Uint8Array}} model K, and the bytes (N K) of vertices, that of the cap last.
 * @param {Float32Array} lit (C K 4) of `lightFunctions`.
 * @param {number} [begin] First vertex.
 * @param {number} [end] Vertex after the last.
 * @returns {Float32Array} (3 (end - begin))
 */
export function radianceOfVertices({ functions, bytes }, lit, begin = 0, end = bytes.length / functions) {
  const radiance = new Float32Array(3 * (end - begin));
  for (let vertex = begin; vertex < end; vertex++) {
    const at = vertex * functions, mean = 4 * functions * bytes[at + functions - 1];
    let r = 0, g = 0, b = 0;
    for (let k = 1; k < functions; k++) {
      const byte = bytes[at + k - 1], place = mean + 4 * k;
      r += byte * lit[place];
      g += byte * lit[place + 1];
      b += byte * lit[place + 2];
    }
    const to = 3 * (vertex - begin);
    radiance[to] = lit[mean] + r / 255;
    radiance[to + 1] = lit[mean + 1] + g / 255;
    radiance[to + 2] = lit[mean + 2] + b / 255;
  }
  return radiance;
}

/**
 * One drawn vertex for each receiver: several are drawn where a surface is cut, and count once.
 *
 * @param {?Uint32Array} receivers (N) of drawn vertices, or null if each has its own.
 * @returns {?Uint32Array} Vertices that count; null for all.
 */
export function countedVertices(receivers) {
  if (!receivers) return null;
  const last = receivers.reduce((most, receiver) => Math.max(most, receiver), 0), seen = new Uint8Array(last + 1);
  return Uint32Array.from(receivers.keys()).filter(vertex => {
    const first = !seen[receivers[vertex]];
    seen[receivers[vertex]] = 1;
    return first;
  });
}

/**
 * Fraction of vertices whose radiance is below zero in a channel, by more than sampling noise.
 *
 * @param {{functions: number, bytes: Uint8Array}} model
 * @param {Float32Array} lit (C K 4) of `lightFunctions`.
 * @param {{reflectance?: ?Uint16Array, counted?: ?Uint32Array}} [options] What white radiance is multiplied by (3 N,
 *   65535 is one), or null; of `countedVertices`.
 * @returns {Promise<number>}
 */
export async function negativeFraction(model, lit, { reflectance = null, counted = null } = {}) {
  const count = model.bytes.length / model.functions, least = new Float32Array(count);
  let most = 0;
  await inPieces(Math.ceil(count / PIECE), piece => {
    const begin = piece * PIECE, end = Math.min(begin + PIECE, count);
    const radiance = radianceOfVertices(model, lit, begin, end);
    if (reflectance) for (let i = 0; i < radiance.length; i++) radiance[i] *= reflectance[3 * begin + i] / 65535;
    for (let i = 0; i < radiance.length; i += 3) {
      const r = radiance[i], g = radiance[i + 1], b = radiance[i + 2];
      least[begin + i / 3] = Math.min(r, g, b);
      most = Math.max(most, r, g, b);
    }
  });
  let negative = 0;
  if (counted) counted.forEach(vertex => { negative += least[vertex] < -NOISE * most ? 1 : 0; });
  else least.forEach(value => { negative += value < -NOISE * most ? 1 : 0; });
  return negative / Math.max(counted ? counted.length : count, 1);
}

/**
 * Coefficients under the widest window that leaves 0.1 % of the vertices negative; unchanged if no more are so.
 *
 * @param {object} model Of `lightFunctions` and `radianceOfVertices`.
 * @param {ArrayLike<number>} coefficients (3 (L+1)²)
 * @param {string} window `hann` or `lanczos`.
 * @param {object} [options] Of `negativeFraction`.
 * @returns {Promise<{coefficients: Float64Array, width: number, before: number, after: number}>} The width is Infinity
 *   where nothing is to be done; fractions without and with the window.
 */
export async function dampLight(model, coefficients, window, options = {}) {
  const plain = Float64Array.from(coefficients), bandlimit = Math.sqrt(plain.length / 3) - 1;
  const fraction = light => negativeFraction(model, lightFunctions(model, light), options);
  const before = await fraction(plain);
  if (before <= LEFT_NEGATIVE) return { coefficients: plain, width: Infinity, before, after: before };
  const at = width => damped(plain, windowFactors(window, bandlimit, width));
  const width = await widestWindow(async w => (await fraction(at(w))) <= LEFT_NEGATIVE, bandlimit);
  return { coefficients: at(width), width, before, after: await fraction(at(width)) };
}

/** The widest window that will do, to 1 %. */
async function widestWindow(suffices, bandlimit) {
  let low = 0.5, high = WIDEST * (bandlimit + 1);
  while (high > 1.01 * low) {
    const widths = Array.from({ length: WIDTHS }, (_, i) => low * (high / low) ** (i / (WIDTHS - 1)));
    // From the widest down: the last that will do counts, as narrower ones may fail again.
    let last = WIDTHS - 1;
    while (last >= 0 && !(await suffices(widths[last]))) last--;
    if (last === WIDTHS - 1) return high;
    if (last < 0) return low; // not even degree 0 alone, which only a broken transfer does
    [low, high] = [widths[last], widths[last + 1]];
  }
  return low;
}
