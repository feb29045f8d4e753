/** What becomes of linear radiance on its way to the screen: relighting/drawing/pictures.py in GLSL and JavaScript. */

/** GLSL: `rollOff`, `encodeSrgb`, and the same for what the legend of differences is drawn with. */
export const TONE = `
vec3 rollOff(vec3 linear) {
  linear = max(linear, 0.0);
  if (all(lessThanEqual(linear, vec3(0.8)))) return linear;
  vec3 falling = exp(-2.0 * (linear - 0.8) / 0.2); // tanh by what cannot overflow
  vec3 rolled = 0.8 + 0.2 * (1.0 - falling) / (1.0 + falling);
  return mix(linear, rolled, vec3(greaterThan(linear, vec3(0.8))));
}

vec3 encodeSrgb(vec3 linear) {
  vec3 curved = 1.055 * pow(max(linear, 1e-8), vec3(1.0 / 2.4)) - 0.055;
  return mix(curved, 12.92 * linear, vec3(lessThanEqual(linear, vec3(0.0031308))));
}
`;

/** What the 95th percentile of covered pixels is shown as, before stops. */
const TARGET = 0.85;

/**
 * The factor that brings the 95th percentile of covered pixels to 0.85, interpolated as NumPy's `percentile` does.
 *
 * @param {Float32Array} pixels - Linear radiance and coverage, 4 numbers for each.
 * @returns {number} 1 where nothing is covered or all is dark.
 */
export function exposureOf(pixels) {
  const levels = new Float32Array(pixels.length / 4);
  let count = 0;
  for (let i = 0; i < pixels.length; i += 4) {
    if (pixels[i + 3] > 0.5) levels[count++] = Math.max(pixels[i], pixels[i + 1], pixels[i + 2]);
  }
  if (count === 0) return 1;
  const sorted = levels.subarray(0, count).sort();
  const place = 0.95 * (count - 1);
  const before = Math.floor(place);
  const after = Math.min(before + 1, count - 1);
  const level = sorted[before] + (place - before) * (sorted[after] - sorted[before]);
  return level > 0 ? TARGET / level : 1;
}

/** Linear light (3) of a colour `#rrggbb`. */
export function linearColour(hex) {
  return [1, 3, 5].map((at) => {
    const value = parseInt(hex.slice(at, at + 2), 16) / 255;
    return value <= 0.04045 ? value / 12.92 : ((value + 0.055) / 1.055) ** 2.4;
  });
}
