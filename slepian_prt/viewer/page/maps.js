// Environment maps from files that are given to the page, by the rules of Python's lighting/map_files.py.

import { readExr } from "#exr";
import { isExr } from "#exrHeader";
import { readHdr } from "#hdr";
import { MapError, checkTexels } from "#mapChecks";
import { readPfm } from "#pfm";
import { readPicture } from "#pictures";

/**
 * A latitude-longitude map of linear radiance. What kind of file it is, its content tells, whatever its name.
 *
 * @param {string} name Of the file.
 * @param {ArrayBuffer} buffer What is in it.
 * @param {{clampNegative?: boolean, anyShape?: boolean}} [options] Zeros for negative texels however much light they
 *   are; maps that are not twice as wide as high, which Mitsuba's emitters may have.
 * @returns {Promise<{name: string, width: number, height: number, data: Float32Array, clamped: number,
 *   notes: string[]}>} name without its suffix; RGB (3 W H) from the top, none negative, H >= 3; how many texels were
 *   set to zero; sentences on what was decided.
 * @throws {MapError} One sentence for what is no map; `negative` is true if `clampNegative` would help.
 */
export async function readMap(name, buffer, { clampNegative = false, anyShape = false } = {}) {
  try {
    const bytes = new Uint8Array(buffer), map = await readerOf(bytes)(bytes, anyShape);
    const clamped = await checkTexels(map, clampNegative);
    const notes = map.notes.map(note => `${name}: ${note}`);
    return { name: name.replace(/(.)\.[^.]*$/, "$1"), ...withThreeRows(map), clamped, notes };
  } catch (error) {
    if (error instanceof MapError) throw new MapError(`${name}: ${error.message}`, error.negative);
    const reason = `cannot be read as an environment map (${error.message})`;
    throw new MapError(`${name}: ${reason}; write it again, best as .exr`);
  }
}

/** Who reads what files begin with. */
function readerOf(bytes) {
  const start = String.fromCharCode(...bytes.subarray(0, 2));
  if (isExr(bytes)) return readExr;
  if (start === "#?") return readHdr;
  return start === "PF" || start === "Pf" ? readPfm : readPicture;
}

/** A map of fewer than three rows, the fewest that Mitsuba takes, with its last repeated. */
function withThreeRows({ width, height, data }) {
  if (height >= 3) return { width, height, data };
  const grown = new Float32Array(9 * width);
  for (let row = 0; row < 3; row++) {
    const from = 3 * width * Math.min(row, height - 1);
    grown.set(data.subarray(from, from + 3 * width), 3 * width * row);
  }
  return { width, height: 3, data: grown };
}
