// Colours of other primaries in those of sRGB, as Python's lighting/formats/primaries.py: white is not adapted.

import { multiplyMatrices } from "#harmonics";

// x and y of red, green, blue and white (ITU-R BT.709-6, Sec. 1).
const SRGB = [0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.3290];

/**
 * From linear colours of the given primaries to linear sRGB; null if they are the same.
 *
 * @param {ArrayLike<number>} chromaticities (8) x and y of red, green, blue and white.
 * @returns {?Float64Array} (9) row by row.
 * @throws {Error} Numbers that are no primaries.
 */
export function toSrgb(chromaticities) {
  const given = Array.from(chromaticities);
  const wrong = () => new Error("its chromaticities are no primaries");
  if (!given.every(Number.isFinite) || [1, 3, 5, 7].some(i => given[i] <= 0)) throw wrong();
  if (given.every((value, i) => Math.abs(value - SRGB[i]) < 1e-3)) return null;
  const matrix = multiplyMatrices(xyzToSrgb(), toXyz(given));
  if (!matrix.every(Number.isFinite)) throw wrong();
  return matrix;
}

/** From CIE XYZ to linear sRGB, whose white has Y = 1; (9) row by row. */
export function xyzToSrgb() {
  return inverse(toXyz(SRGB));
}

function toXyz(xy) {
  const column = i => [xy[2 * i] / xy[2 * i + 1], 1, (1 - xy[2 * i] - xy[2 * i + 1]) / xy[2 * i + 1]];
  const colours = [column(0), column(1), column(2)], white = column(3);
  const matrix = Float64Array.from({ length: 9 }, (_, i) => colours[i % 3][Math.floor(i / 3)]);
  const back = inverse(matrix);
  const amounts = [0, 1, 2].map(i => back[3 * i] * white[0] + back[3 * i + 1] * white[1] + back[3 * i + 2] * white[2]);
  return matrix.map((value, i) => value * amounts[i % 3]);
}

function inverse(m) {
  const cofactor = (a, b, c, d) => m[a] * m[d] - m[b] * m[c];
  const adjugate = [
    cofactor(4, 5, 7, 8), cofactor(2, 1, 8, 7), cofactor(1, 2, 4, 5),
    cofactor(5, 3, 8, 6), cofactor(0, 2, 6, 8), cofactor(2, 0, 5, 3),
    cofactor(3, 4, 6, 7), cofactor(1, 0, 7, 6), cofactor(0, 1, 3, 4),
  ];
  const determinant = m[0] * adjugate[0] + m[1] * adjugate[3] + m[2] * adjugate[6];
  return Float64Array.from(adjugate, value => value / determinant);
}
