/** The lights of the page: as they stand, turned, windowed; their maps, and maps that are dropped on the page. */

import { damped, multiplyMatrices, rotateSh, windowFactors } from "#harmonics";
import { readMap } from "#maps";
import { projectTexels } from "#projection";

/**
 * @typedef {object} Light
 * @property {string} name
 * @property {ArrayLike<number>} coefficients - (3 (L+1)²) in the world, as it stands.
 * @property {Float64Array} toWorld - (9) of its map, as that stands.
 * @property {?Uint8Array} bytes - The file of its map.
 * @property {string} suffix
 * @property {?object} map - Once it is read.
 */

/** Lights of the payload, in the form that the page has them. */
export function lightsOf(payload) {
  return payload.lights.map((light) => ({
    name: light.name,
    coefficients: light.coefficients,
    toWorld: Float64Array.from(light.to_world.flat()),
    bytes: light.map,
    suffix: light.suffix,
    map: null,
  }));
}

/** The rotation (9) from a map's frame, y up, to a world whose up axis is z; else none. */
export function upRotation(up) {
  return up === "z" ? [1, 0, 0, 0, 0, -1, 0, 1, 0] : [1, 0, 0, 0, 1, 0, 0, 0, 1];
}

/**
 * The rotation (9) of a light: tilted about the x axis, then turned about the axis that is up, counter-clockwise seen
 * from above.
 */
export function turnOf({ turn, tilt }, up) {
  const [t, s] = [turn, tilt].map((degrees) => (degrees * Math.PI) / 180);
  const [c, d] = [Math.cos(t), Math.sin(t)];
  const about = up === "z" ? [c, -d, 0, d, c, 0, 0, 0, 1] : [c, 0, d, 0, 1, 0, -d, 0, c];
  return multiplyMatrices(about, [1, 0, 0, 0, Math.cos(s), -Math.sin(s), 0, Math.sin(s), Math.cos(s)]);
}

/**
 * Coefficients of a light as it is turned, under a window.
 *
 * @param {Light} light
 * @param {object} values - `turn`, `tilt` of the state.
 * @param {{bandlimit: number, up: string, window: {name: string}}} payload
 * @param {number} [width] - Of the window; none if infinite.
 */
export function coefficientsOf(light, values, payload, width = Infinity) {
  const isTurned = values.turn !== 0 || values.tilt !== 0;
  const { bandlimit, up, window } = payload;
  const turned = isTurned ? rotateSh(light.coefficients, bandlimit, turnOf(values, up)) : light.coefficients;
  return Number.isFinite(width) ? damped(turned, windowFactors(window.name, bandlimit, width)) : turned;
}

/** The rotation (9) of a light's map to the world, as it is turned. */
export function standOf(light, values, up) {
  return multiplyMatrices(turnOf(values, up), light.toWorld);
}

/** Read the map of a light, once. */
export async function mapOf(light) {
  if (light.map === null && light.bytes !== null) {
    const { buffer, byteOffset, byteLength } = light.bytes;
    const content = buffer.slice(byteOffset, byteOffset + byteLength);
    light.map = await readMap(`${light.name}${light.suffix}`, content, { clampNegative: true, anyShape: true });
  }
  return light.map;
}

/**
 * A light from a file.
 *
 * @param {File} file
 * @param {{bandlimit: number, up: string}} payload
 * @returns {Promise<{light: Light, notes: string[]}>}
 * @throws {Error} One sentence for what is no map.
 */
export async function lightOfFile(file, { bandlimit, up }) {
  const content = await file.arrayBuffer();
  const map = await readMap(file.name, content).catch((error) => {
    if (!error.negative) throw error;
    return readMap(file.name, content, { clampNegative: true }); // it is said below how many
  });
  const toWorld = Float64Array.from(upRotation(up));
  const coefficients = await projectTexels(map, bandlimit, toWorld);
  const notes = [...map.notes];
  if (map.clamped > 0) notes.push(`${file.name}: ${map.clamped} negative texels were set to zero`);
  return { light: { name: map.name, coefficients, toWorld, bytes: null, suffix: "", map }, notes };
}
