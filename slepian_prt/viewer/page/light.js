// Light that the functions of caps receive: what the vertex shader multiplies the bytes of a vertex with.

/**
 * RGB numbers of every function of every cap under a light, as a float texture K x C takes them.
 *
 * A vertex of cap c with bytes q_1 … q_(K-1) sends back lit_c0 + Σ_k q_k/255 lit_ck: from the mean the zeros of the
 * bytes, z_k lit_ck, are taken away here. Functions that are not used are zero.
 *
 * @param {{functions: number, caps: number, channels: number, table: Float32Array, zeros: Float32Array}} model K and C;
 *   transfer functions (C K channels (L+1)²) and where the bytes are zero (C (K-1)).
 * @param {ArrayLike<number>} coefficients (3 (L+1)²) of red, of green, of blue.
 * @param {number} [used] How many of the functions, the mean among them.
 * @returns {Float32Array} (C K 4), the last of four 0.
 */
export function lightFunctions(model, coefficients, used = model.functions) {
  const { functions, caps, channels, table, zeros } = model;
  const size = coefficients.length / 3, lit = new Float32Array(4 * caps * functions);
  const light = Float64Array.from(coefficients), sums = new Float64Array(3);
  for (let cap = 0; cap < caps; cap++) {
    const mean = [0, 0, 0];
    for (let k = 0; k < Math.min(used, functions); k++) {
      const place = cap * functions + k;
      dotLight(table, place * channels * size, channels, light, size, sums);
      for (let colour = 0; colour < 3; colour++) {
        if (k > 0) lit[4 * place + colour] = sums[colour];
        mean[colour] += k > 0 ? -zeros[cap * (functions - 1) + k - 1] * sums[colour] : sums[colour];
      }
    }
    lit.set(mean, 4 * cap * functions);
  }
  return lit;
}

/** Σ f_m e_m of three colours, for a function that is one for all of them or has one for each. */
function dotLight(table, at, channels, light, size, sums) {
  const green = channels === 3 ? at + size : at, blue = channels === 3 ? at + 2 * size : at;
  let r = 0, g = 0, b = 0;
  for (let m = 0; m < size; m++) {
    r += table[at + m] * light[m];
    g += table[green + m] * light[size + m];
    b += table[blue + m] * light[2 * size + m];
  }
  sums[0] = r;
  sums[1] = g;
  sums[2] = b;
}
