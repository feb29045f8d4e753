/** Colours that stand for numbers: a perceptual scale for differences, and colours of caps that can be told apart. */

// Viridis (van der Walt and Smith 2015, CC0) by polynomials of degree 6 (Zucker 2019): within 0.01 of the table.
const COEFFICIENTS = [
  [0.2777273272234177, 0.005407344544966578, 0.3340998053353061],
  [0.1050930431085774, 1.404613529898575, 1.384590162594685],
  [-0.3308618287255563, 0.214847559468213, 0.09509516302823659],
  [-4.634230498983486, -5.799100973351585, -19.33244095627987],
  [6.228269936347081, 14.17993336680509, 56.69055260068105],
  [4.776384997670288, -13.74514537774601, -65.35303263337234],
  [-5.435455855934631, 4.645852612178535, 26.3124352495832],
];

const glsl = (colour) => `vec3(${colour.map((value) => value.toFixed(9)).join(", ")})`;

/** GLSL: `vec3 colourOf(float)`, sRGB from 0 to 1. */
export const COLOUR_MAP = `
vec3 colourOf(float t) {
  vec3 colour = ${glsl(COEFFICIENTS[6])};
${[5, 4, 3, 2, 1, 0].map((n) => `  colour = ${glsl(COEFFICIENTS[n])} + t * colour;`).join("\n")}
  return colour;
}
`;

/** The same as a CSS gradient from left to right. */
export function colourGradient() {
  const stops = Array.from({ length: 17 }, (_, i) => {
    const t = i / 16;
    const colour = COEFFICIENTS[0].map((_, c) => {
      const value = COEFFICIENTS.reduceRight((sum, row) => row[c] + t * sum, 0);
      return Math.round(255 * Math.min(1, Math.max(0, value)));
    });
    return `rgb(${colour.join(" ")})`;
  });
  return `linear-gradient(to right, ${stops.join(", ")})`;
}

/**
 * Linear colours of caps: hues at the golden angle, in three lightnesses, in Oklab (Ottosson 2020).
 *
 * @param {number} count
 * @returns {Float32Array} 4 numbers for each.
 */
export function capColours(count) {
  const colours = new Float32Array(4 * count);
  for (let c = 0; c < count; ++c) {
    const hue = c * 2.399963229728653;
    const lightness = [0.74, 0.62, 0.84][c % 3];
    const a = 0.115 * Math.cos(hue);
    const b = 0.115 * Math.sin(hue);
    const l = (lightness + 0.3963377774 * a + 0.2158037573 * b) ** 3;
    const m = (lightness - 0.1055613458 * a - 0.0638541728 * b) ** 3;
    const s = (lightness - 0.0894841775 * a - 1.291485548 * b) ** 3;
    colours.set([
      4.0767416621 * l - 3.3077115913 * m + 0.2309699292 * s,
      -1.2684380046 * l + 2.6097574011 * m - 0.3413193965 * s,
      -0.0041960863 * l - 0.7034186147 * m + 1.707614701 * s,
      1,
    ], 4 * c);
  }
  return colours;
}
