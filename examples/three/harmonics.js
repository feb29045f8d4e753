// Light as spherical harmonics, in the conventions of slepian_prt (docs/conventions.md).

/**
 * Real spherical harmonics of a unit vector: orthonormal, Condon–Shortley phase, polar axis z, index l² + l + m.
 *
 * @param {number} bandlimit - Highest degree L.
 * @param {number} x
 * @param {number} y
 * @param {number} z
 * @returns {Float64Array} (L+1)² values.
 */
export function harmonics(bandlimit, x, y, z) {
  const values = new Float64Array((bandlimit + 1) ** 2);
  // Re and Im of (x + iy)^m, times the normalised Legendre function P_lm(z) / (sin θ)^m.
  let cosine = 1, sine = 0, start = Math.sqrt(1 / (4 * Math.PI));
  for (let m = 0; m <= bandlimit; m++) {
    if (m > 0) {
      [cosine, sine] = [cosine * x - sine * y, cosine * y + sine * x];
      start *= -Math.sqrt((2 * m + 1) / (2 * m)) * (m === 1 ? Math.SQRT2 : 1);
    }
    let before = 0, now = start;
    for (let l = m; l <= bandlimit; l++) {
      values[l * l + l + m] = now * cosine;
      if (m > 0) values[l * l + l - m] = now * sine;
      const a = Math.sqrt((4 * (l + 1) ** 2 - 1) / ((l + 1) ** 2 - m * m));
      const b = l > m ? Math.sqrt((l * l - m * m) / (4 * l * l - 1)) : 0;
      [before, now] = [now, a * (z * now - b * before)];
    }
  }
  return values;
}

/**
 * The light of an environment map: its integrals with the harmonics, in the axes of a model.
 *
 * @param {{width: number, height: number, data: Float32Array}} map - RGB, row by row; the first and last row are on the
 *     poles, y is up, and column c is centred on atan2(x, -z) = 2π (c + ½) / width.
 * @param {number} bandlimit
 * @param {number[]} toModel - Rotation from the world to the model, 9 numbers row by row.
 * @returns {Float64Array} 3 (L+1)²: red, then green, then blue.
 */
export function projectMap({ width, height, data }, bandlimit, toModel) {
  const size = (bandlimit + 1) ** 2, light = new Float64Array(3 * size);
  for (let row = 0; row < height; row++) {
    const step = Math.PI / (height - 1), theta = row * step;
    const above = Math.cos(Math.max(theta - step / 2, 0)), below = Math.cos(Math.min(theta + step / 2, Math.PI));
    const area = (above - below) * (2 * Math.PI / width);
    for (let column = 0; column < width; column++) {
      const phi = 2 * Math.PI * (column + 0.5) / width;
      const w = [Math.sin(theta) * Math.sin(phi), Math.cos(theta), -Math.sin(theta) * Math.cos(phi)];
      const [x, y, z] = [0, 3, 6].map(i => toModel[i] * w[0] + toModel[i + 1] * w[1] + toModel[i + 2] * w[2]);
      const basis = harmonics(bandlimit, x, y, z), texel = 3 * (row * width + column);
      for (let c = 0; c < 3; c++) {
        const radiance = area * data[texel + c];
        for (let i = 0; i < size; i++) light[c * size + i] += radiance * basis[i];
      }
    }
  }
  return light;
}

/**
 * A smaller map, of means, which is as good for few harmonics; sizes that do not divide are left as they are.
 *
 * @param {{width: number, height: number, data: Float32Array}} map - RGB.
 * @param {number} width - Wanted at most.
 * @returns {{width: number, height: number, data: Float32Array}}
 */
export function shrink(map, width) {
  const by = Math.max(1, Math.floor(map.width / width));
  const columns = Math.floor(map.width / by), rows = Math.ceil(map.height / by);
  const data = new Float32Array(3 * columns * rows);
  for (let row = 0; row < rows; row++) {
    // Rows stand on the poles: that of a mean is the nearest, so that none moves by more than half a row of the map.
    const middle = Math.round(row * (map.height - 1) / Math.max(rows - 1, 1));
    const first = Math.max(0, middle - (by >> 1)), last = Math.min(map.height, middle + (by >> 1) + 1);
    for (let column = 0; column < columns; column++) {
      for (let c = 0; c < 3; c++) {
        let sum = 0;
        for (let y = first; y < last; y++) {
          for (let x = column * by; x < (column + 1) * by; x++) sum += map.data[3 * (y * map.width + x) + c];
        }
        data[3 * (row * columns + column) + c] = sum / ((last - first) * by);
      }
    }
  }
  return { width: columns, height: rows, data };
}
