// Real spherical harmonics, orthonormal, with the Condon–Shortley phase: index l² + l + m; m > 0 goes with cos mφ,
// m < 0 with sin |m|φ; z is the polar axis. Everything is as in Python's sphere/harmonics.py, sphere/rotation.py and
// lighting/windowing.py.

/**
 * Degree l of each of the (L+1)² coefficients.
 *
 * @param {number} bandlimit L.
 * @returns {Int32Array} ((L+1)²)
 */
export function degreesOf(bandlimit) {
  const degrees = new Int32Array((bandlimit + 1) ** 2);
  for (let l = 0; l <= bandlimit; l++) degrees.fill(l, l * l, (l + 1) ** 2);
  return degrees;
}

/**
 * Constants of the recurrence of normalised associated Legendre functions, p_lm = a_lm z p_(l-1)m - b_lm p_(l-2)m,
 * which leave out the factor sin^m θ.
 *
 * @param {number} bandlimit L.
 * @returns {{start: Float64Array, a: Float64Array, b: Float64Array}} Values at l = m (L+1), and a_lm and b_lm at
 *   l (L+1) + m.
 */
export function legendreFactors(bandlimit) {
  const size = bandlimit + 1;
  const start = new Float64Array(size), a = new Float64Array(size * size), b = new Float64Array(size * size);
  // The running product of ratios next to one keeps its digits.
  let product = 1;
  for (let m = 0; m <= bandlimit; m++) {
    if (m > 0) product *= (2 * m + 1) / (2 * m);
    start[m] = Math.sqrt(product / (4 * Math.PI)) * (m === 0 ? 1 : m % 2 ? -Math.SQRT2 : Math.SQRT2);
  }
  for (let l = 1; l <= bandlimit; l++) {
    for (let m = 0; m < l; m++) {
      const span = l * l - m * m;
      a[l * size + m] = Math.sqrt((4 * l * l - 1) / span);
      if (m < l - 1) b[l * size + m] = Math.sqrt((((l - 1) ** 2 - m * m) * (2 * l + 1)) / ((2 * l - 3) * span));
    }
  }
  return { start, a, b };
}

/**
 * Coefficients of ω ↦ f(Rᵀω), given those of f: of one function or of several, one after the other.
 *
 * With R = Rz(α) Ry(β) Rz(γ) only Ry needs work: it is Jᵀ Z(β) J with one orthogonal matrix J per degree.
 *
 * @param {ArrayLike<number>} coefficients (n (L+1)²)
 * @param {number} bandlimit L.
 * @param {ArrayLike<number>} rotation (9) a proper rotation R, row by row.
 * @returns {Float64Array} (n (L+1)²)
 * @throws {Error} A matrix that is no rotation (beyond 1e-6), or another number of coefficients.
 */
export function rotateSh(coefficients, bandlimit, rotation) {
  const size = (bandlimit + 1) ** 2, count = coefficients.length / size;
  if (!Number.isInteger(count)) {
    throw new Error(`coefficients must be a multiple of ${size} at bandlimit ${bandlimit}, not ${coefficients.length}`);
  }
  const [alpha, beta, gamma] = eulerZyz(rotation).map(angle => cosSinMultiples(bandlimit, angle));
  const rotated = Float64Array.from(coefficients);
  const inside = new Float64Array(2 * bandlimit + 1);
  for (let l = 0; l <= bandlimit; l++) {
    const aboutY = toYAxis(l), width = 2 * l + 1;
    for (let n = 0; n < count; n++) {
      const v = rotated.subarray(n * size + l * l, n * size + (l + 1) ** 2);
      turn(v, l, gamma);
      for (let row = 0; row < width; row++) {
        let sum = 0;
        for (let column = 0; column < width; column++) sum += aboutY[row * width + column] * v[column];
        inside[row] = sum;
      }
      turn(inside, l, beta);
      v.fill(0);
      for (let row = 0; row < width; row++) {
        for (let column = 0; column < width; column++) v[column] += aboutY[row * width + column] * inside[row];
      }
      turn(v, l, alpha);
    }
  }
  return rotated;
}

/** Rotates one degree in place about z by the angle whose multiples are given. */
function turn(v, l, { cos, sin }) {
  for (let m = 1; m <= l; m++) {
    const even = v[l + m], odd = v[l - m];
    v[l + m] = even * cos[m] - odd * sin[m];
    v[l - m] = odd * cos[m] + even * sin[m];
  }
}

function cosSinMultiples(bandlimit, angle) {
  const multiples = Array.from({ length: bandlimit + 1 }, (_, m) => m * angle);
  return { cos: multiples.map(Math.cos), sin: multiples.map(Math.sin) };
}

/**
 * Angles with R = Rz(α) Ry(β) Rz(γ). γ is read from what is left once α and β are undone: next to β = 0 and π each of
 * α and γ alone is ill-determined, but their errors then cancel.
 */
function eulerZyz(r) {
  checkRotation(r);
  const alpha = Math.atan2(r[5], r[2]);
  const beta = Math.atan2(Math.hypot(r[2], r[5]), r[8]);
  const cosA = Math.cos(alpha), sinA = Math.sin(alpha);
  const leftX = Math.cos(beta) * (cosA * r[0] + sinA * r[3]) - Math.sin(beta) * r[6];
  return [alpha, beta, Math.atan2(cosA * r[3] - sinA * r[0], leftX)];
}

function checkRotation(r) {
  let defect = r.length === 9 ? 0 : Infinity;
  for (let i = 0; i < 3; i++) {
    for (let j = 0; j < 3; j++) {
      const product = r[3 * i] * r[3 * j] + r[3 * i + 1] * r[3 * j + 1] + r[3 * i + 2] * r[3 * j + 2];
      defect = Math.max(defect, Math.abs(product - (i === j ? 1 : 0)));
    }
  }
  const determinant = r[0] * (r[4] * r[8] - r[5] * r[7]) - r[1] * (r[3] * r[8] - r[5] * r[6])
    + r[2] * (r[3] * r[7] - r[4] * r[6]);
  if (!(defect <= 1e-6) || determinant < 0) {
    throw new Error(`rotation must be a proper rotation matrix (R Rᵀ differs from 1 by ${defect.toPrecision(3)})`);
  }
}

const axes = new Map();

/**
 * The orthogonal J of degree l, row by row, ordered like m, for which Ry(β) = Jᵀ Z(β) J.
 *
 * The generator of rotations about y leaves the functions even in y (m >= 0) and those odd in y (m < 0) apart. On each
 * it is antisymmetric tridiagonal, D (iT) D* with D = diag(iᵏ) and T real symmetric, whose eigenvalues are every other
 * integer μ from -l; an eigenvector v with μ > 0 gives the plane (√2 Re Dv, -√2 Im Dv) that Ry(β) turns by μβ.
 */
function toYAxis(l) {
  if (axes.has(l)) return axes.get(l);
  const width = 2 * l + 1, j = new Float64Array(width * width);
  for (const first of l > 0 ? [0, 1] : [0]) {
    const sign = first === 0 ? 1 : -1;
    for (let mu = l - first; mu >= 0; mu -= 2) {
      const v = eigenvector(l, first, mu);
      const scale = mu > 0 ? Math.SQRT2 : 1;
      v.forEach((value, k) => {
        const column = l + sign * (first + k), unit = k % 4 < 2 ? 1 : -1;
        // iᵏ is real for even k and imaginary for odd; with μ = 0 only one of the two is there.
        const row = mu === 0 ? l : k % 2 === 0 ? l + mu : l - mu;
        j[row * width + column] = scale * unit * (mu > 0 && k % 2 === 1 ? -value : value);
      });
    }
  }
  axes.set(l, j);
  return j;
}

/**
 * The unit eigenvector of T to an eigenvalue μ, from its recurrence. From m = l down it first grows and then
 * oscillates, so that no rounding is magnified; from m = 0 up it would be.
 */
function eigenvector(l, first, mu) {
  const size = l + 1 - first, v = new Float64Array(size);
  const coupling = k => 0.5 * Math.sqrt((l - first - k) * (l + first + k + 1)) * (first + k === 0 ? Math.SQRT2 : 1);
  v[size - 1] = 1;
  for (let k = size - 1; k > 0; k--) {
    const above = k < size - 1 ? coupling(k) * v[k + 1] : 0;
    v[k - 1] = (mu * v[k] - above) / coupling(k - 1);
  }
  const norm = Math.hypot(...v);
  return v.map(value => value / norm);
}

/** Names of the windows. */
export const WINDOWS = ["hann", "lanczos"];

/**
 * Factors of degrees 0 … L, which damp the ringing of small bright lights.
 *
 * @param {string} name `hann`, (1 + cos πl/w)/2, or `lanczos`, sin(πl/w)/(πl/w); both zero from degree w.
 * @param {number} bandlimit L.
 * @param {number} width w, larger than 0.
 * @returns {Float64Array} (L+1)
 */
export function windowFactors(name, bandlimit, width) {
  if (!WINDOWS.includes(name)) throw new Error(`window must be one of ${WINDOWS.join(", ")}, not ${name}`);
  if (!(width > 0 && width < Infinity)) {
    throw new Error(`width of the window must be larger than 0 degrees, not ${width}`);
  }
  return Float64Array.from({ length: bandlimit + 1 }, (_, l) => {
    if (l >= width) return 0;
    const x = (Math.PI * l) / width;
    return name === "hann" ? 0.5 * (1 + Math.cos(x)) : l === 0 ? 1 : Math.sin(x) / x;
  });
}

/**
 * Coefficients with each degree damped.
 *
 * @param {ArrayLike<number>} coefficients (n (L+1)²)
 * @param {ArrayLike<number>} factors (L+1)
 * @returns {Float64Array} (n (L+1)²)
 */
export function damped(coefficients, factors) {
  const degrees = degreesOf(factors.length - 1);
  return Float64Array.from(coefficients, (value, i) => value * factors[degrees[i % degrees.length]]);
}

/**
 * The product of two matrices.
 *
 * @param {ArrayLike<number>} a (9) row by row.
 * @param {ArrayLike<number>} b (9)
 * @returns {Float64Array} (9)
 */
export function multiplyMatrices(a, b) {
  return Float64Array.from({ length: 9 }, (_, i) => {
    const row = 3 * Math.floor(i / 3), column = i % 3;
    return a[row] * b[column] + a[row + 1] * b[3 + column] + a[row + 2] * b[6 + column];
  });
}
