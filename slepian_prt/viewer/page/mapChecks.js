// What texels of a map must be, wherever they come from: the rules of Python's lighting/map_rows.py.

import { inPieces } from "#tasks";

// More negative energy than this part of the positive is no rounding of an encoder but a broken map.
const NEGATIVE_TOLERANCE = 1e-3;

// Brighter than any light, and low enough that radiance of receivers stays far below the end of float32, 3.4e38.
const BRIGHTEST = 1e30;

// More is no map but a damaged header: 65536 x 32768, and the longest side of a larger window that holds it.
const MOST_TEXELS = 2 ** 31, LONGEST_SIDE = 2 ** 17;

/**
 * What is wrong with a file, in words that go on from its name and say what to do.
 *
 * `negative` is true if nothing is wrong but negative texels, which may be set to zero.
 */
export class MapError extends Error {
  constructor(message, negative = false) {
    super(message);
    this.name = "MapError";
    this.negative = negative;
  }
}

/** Throws unless a map is twice as wide as high, and of a size that maps have. */
export function checkShape(width, height, anyShape = false) {
  checkSize(width, height);
  if (width !== 2 * height && !anyShape) {
    throw new MapError(`is ${width} x ${height} texels; a latitude-longitude map is twice as wide as high, so convert `
      + "it (a cube map or light probe needs to be resampled) or crop it");
  }
}

/** Throws for a picture without texels, or with more than any map has; before memory is taken for it. */
export function checkSize(width, height) {
  if (height <= 0 || width <= 0) {
    throw new MapError(`is ${width} x ${height} texels, so there is no light in it; write it again`);
  }
  if (height * width > MOST_TEXELS || Math.max(height, width) > LONGEST_SIDE) {
    throw new MapError(`says it is ${width} x ${height} texels, and at most 65536 x 32768 are read; make it smaller`);
  }
}

/** Room for RGB texels, unless the browser has none. */
export function makeTexels(width, height) {
  try {
    return new Float32Array(3 * width * height);
  } catch {
    throw new MapError(`is ${width} x ${height} texels, more than the browser has memory for; make it smaller`);
  }
}

/**
 * Sets negative texels to zero, if they amount to at most a thousandth of the light (by solid angle, summed over the
 * colours), which resampling and encoders leave, or if that is asked for.
 *
 * @param {{width: number, height: number, data: Float32Array}} map Linear RGB (3 W H), row by row; changed in place.
 * @param {boolean} clampNegative Zeros for negative texels however much light they are.
 * @returns {Promise<number>} Texels that were set to zero.
 * @throws {MapError} NaN, infinite or absurdly bright texels, or negative ones that matter.
 */
export async function checkTexels({ width, height, data }, clampNegative) {
  let lost = 0, kept = 0, lowest = 0, clamped = 0;
  await inPieces(height, row => {
    let negative = 0, positive = 0;
    for (let i = 3 * width * row; i < 3 * width * (row + 1); i += 3) {
      const red = data[i], green = data[i + 1], blue = data[i + 2];
      const least = Math.min(red, green, blue), most = Math.max(red, green, blue);
      if (!(most <= BRIGHTEST && least >= -BRIGHTEST)) throw unusable(data, width, row);
      if (least < 0) {
        lowest = Math.min(lowest, least);
        clamped++;
        for (let colour = i; colour < i + 3; colour++) {
          if (data[colour] < 0) {
            negative -= data[colour];
            data[colour] = 0;
          }
        }
      }
      positive += data[i] + data[i + 1] + data[i + 2];
    }
    const solidAngle = Math.sin(((row + 0.5) * Math.PI) / height); // but for a factor
    lost += negative * solidAngle;
    kept += positive * solidAngle;
  });
  if (lost > NEGATIVE_TOLERANCE * kept && !clampNegative) {
    const part = `amount to ${((100 * lost) / kept).toFixed(1)}% of the light`;
    const share = lost < kept ? part : "outweigh all light in the map";
    throw new MapError(`${clamped} texels are negative (down to ${Number(lowest.toPrecision(4))}) and ${share}; repair `
      + "the map, or set them to zero", true);
  }
  return clamped;
}

/** What is wrong with the first texel of a row that no calculation can follow. */
function unusable(data, width, row) {
  const texel = column => data.subarray(3 * (width * row + column), 3 * (width * row + column + 1));
  const texels = Array.from({ length: width }, (_, column) => texel(column));
  const infinite = texels.findIndex(values => !values.every(Number.isFinite));
  if (infinite >= 0) {
    return new MapError(`texels are NaN or infinite, the first in row ${row}, column ${infinite}; repair the map`);
  }
  const bright = texels.findIndex(values => values.some(value => Math.abs(value) > BRIGHTEST));
  return new MapError("texels are beyond 1e+30, more than can be calculated with, the first in row "
    + `${row}, column ${bright}; scale the map down`);
}
