// Radiance of a latitude-longitude map as spherical harmonics, the numbers of Python's lighting/texel_projection.py:
// texel (row r, column c) of Mitsuba's `envmap` is centred on u = (c + ½)/W = atan2(x, -z)/2π and v = r/(H - 1) =
// acos(y)/π, and the map is interpolated bilinearly.

import { legendreFactors, multiplyMatrices, rotateSh } from "#harmonics";
import { inPieces } from "#tasks";

// Rows per degree, and columns per order by half, below which bilinear interpolation matters, and is carried out.
const ROWS_PER_DEGREE = 8;

// Where the map's frame (polar axis z, azimuth -2πu from x) goes in Mitsuba's world, y up; row by row.
const MAP_TO_WORLD = [0, -1, 0, 0, 0, 1, -1, 0, 0];

/**
 * Coefficients of a map in the world. Clenshaw–Curtis weights make them exact for maps that are bandlimited themselves;
 * maps of fewer than 8 rows or 16 columns per degree are interpolated first, as Mitsuba would.
 *
 * @param {{width: number, height: number, data: Float32Array}} map Linear RGB (3 W H), row by row; W is even, H >= 3.
 * @param {number} bandlimit L.
 * @param {ArrayLike<number>} [toWorld] (9) Rotation from the map's frame (y up) to the world, row by row.
 * @returns {Promise<Float64Array>} (3 (L+1)²) of red, of green, of blue.
 */
export async function projectTexels(map, bandlimit, toWorld = [1, 0, 0, 0, 1, 0, 0, 0, 1]) {
  const grid = gridOf(map, bandlimit);
  const rowOf = grid.width === map.width && grid.height === map.height ? mapRow(map) : finerRow(map, grid);
  const transform = lowFrequencies(grid.width, bandlimit);
  const addRow = legendreSum(grid.height, bandlimit);
  const inMap = new Float64Array(3 * (bandlimit + 1) ** 2);
  await inPieces(grid.height, row => addRow(row, transform(rowOf(row)), inMap));
  return rotateSh(inMap, bandlimit, multiplyMatrices(toWorld, MAP_TO_WORLD));
}

/** Rows and columns that are projected. */
function gridOf({ height, width }, bandlimit) {
  const rows = ROWS_PER_DEGREE * (bandlimit + 1) + 1;
  return {
    height: height >= rows ? height : Math.ceil(rows / height) * height + 1,
    width: Math.ceil((2 * rows) / width) * width,
  };
}

function mapRow({ data, width }) {
  return row => data.subarray(3 * width * row, 3 * width * (row + 1));
}

/** Rows of a finer grid, interpolated bilinearly. */
function finerRow({ data, width, height }, grid) {
  const between = new Float64Array(3 * width), finer = new Float64Array(3 * grid.width);
  return row => {
    const r = (row * (height - 1)) / (grid.height - 1);
    const first = Math.min(Math.floor(r), height - 2), part = r - first, from = 3 * width * first;
    for (let i = 0; i < 3 * width; i++) between[i] = (1 - part) * data[from + i] + part * data[from + 3 * width + i];
    for (let column = 0; column < grid.width; column++) {
      const c = ((column + 0.5) * width) / grid.width - 0.5, floor = Math.floor(c), share = c - floor;
      const left = 3 * ((floor + width) % width), right = 3 * ((floor + 1) % width);
      for (let i = 0; i < 3; i++) {
        finer[3 * column + i] = (1 - share) * between[left + i] + share * between[right + i];
      }
    }
    return finer;
  };
}

/**
 * Fourier coefficients ∫ f e^{-imφ} dφ of a row, with φ = -2π(c + ½)/W the azimuth in the map's frame.
 *
 * Only few orders are wanted of many columns, so that plain sums over half the columns do: half a turn apart, cos mφ
 * and sin mφ are the same for even m and opposite for odd.
 *
 * @returns {(row: ArrayLike<number>) => Float64Array} From (3 W) to ((L+1) 6): of each order the real parts of three
 *   colours, then the imaginary.
 */
function lowFrequencies(width, bandlimit) {
  const half = width / 2;
  const sum = new Float64Array(3 * half), difference = new Float64Array(3 * half);
  const moments = new Float64Array(6 * (bandlimit + 1));
  const cos = new Float64Array(half * (bandlimit + 1)), sin = new Float64Array(half * (bandlimit + 1));
  for (let m = 0; m <= bandlimit; m++) {
    for (let c = 0; c < half; c++) {
      const angle = (Math.PI * ((m * (2 * c + 1)) % (2 * width))) / width; // reduced while it is an integer
      cos[m * half + c] = Math.cos(angle);
      sin[m * half + c] = Math.sin(angle);
    }
  }
  const step = (2 * Math.PI) / width;
  return row => {
    for (let i = 0; i < 3 * half; i++) {
      sum[i] = row[i] + row[i + 3 * half];
      difference[i] = row[i] - row[i + 3 * half];
    }
    for (let m = 0; m <= bandlimit; m++) {
      const folded = m % 2 ? difference : sum;
      let cosR = 0, cosG = 0, cosB = 0, sinR = 0, sinG = 0, sinB = 0;
      for (let c = 0, i = 0, at = m * half; c < half; c++, i += 3, at++) {
        const x = cos[at], y = sin[at], red = folded[i], green = folded[i + 1], blue = folded[i + 2];
        cosR += x * red; cosG += x * green; cosB += x * blue;
        sinR += y * red; sinG += y * green; sinB += y * blue;
      }
      moments.set([cosR * step, cosG * step, cosB * step, sinR * step, sinG * step, sinB * step], 6 * m);
    }
    return moments;
  };
}

/** Adds what a row (of the given moments) sends to the coefficients (3 (L+1)²). */
function legendreSum(height, bandlimit) {
  const { start, a, b } = legendreFactors(bandlimit), size = bandlimit + 1;
  const weights = clenshawCurtis(height - 1);
  return (row, moments, coefficients) => {
    const angle = (Math.PI * row) / (height - 1), z = Math.cos(angle), sine = Math.sin(angle);
    let power = weights[row];
    for (let m = 0; m <= bandlimit; m++) {
      let before = 0, p = start[m] * power;
      for (let l = m; l <= bandlimit; l++) {
        if (l > m) {
          const next = a[l * size + m] * z * p - b[l * size + m] * before;
          before = p;
          p = next;
        }
        for (let colour = 0; colour < 3; colour++) {
          const centre = colour * size * size + l * l + l;
          coefficients[centre + m] += p * moments[6 * m + colour];
          if (m) coefficients[centre - m] -= p * moments[6 * m + 3 + colour];
        }
      }
      power *= sine;
    }
  };
}

/**
 * Weights of ∫ f(cos θ) sin θ dθ on θ_j = πj/n, j = 0 … n, exact for polynomials of degree n.
 *
 * @param {number} n
 * @returns {Float64Array} (n+1)
 */
export function clenshawCurtis(n) {
  const cos = Float64Array.from({ length: 2 * n }, (_, i) => Math.cos((Math.PI * i) / n));
  return Float64Array.from({ length: n + 1 }, (_, j) => {
    let sum = 1;
    for (let k = 1; 2 * k <= n; k++) sum -= ((2 * k === n ? 1 : 2) / (4 * k * k - 1)) * cos[(2 * k * j) % (2 * n)];
    return (sum * (j === 0 || j === n ? 1 : 2)) / n;
  });
}
