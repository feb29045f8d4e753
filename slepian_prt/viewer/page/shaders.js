/** Shaders that draw receivers from the run-time format: docs/runtime-format.md has the same sum in words. */

/**
 * GLSL of the sum of a receiver: its bytes times the lit functions of its cap.
 *
 * The bytes are fetched as 32-bit words, four to each, lowest first; the last byte is the number of the cap. A texel
 * (k, c) of `lit` has the red, green and blue of function k of cap c under the light.
 *
 * @param {number} count - Bytes of a receiver, K: a multiple of 8.
 * @returns {string} `vec3 radianceOf(uint words[K / 4])`.
 */
export function radianceSum(count) {
  return `
uniform highp sampler2D lit;

uint capOf(uint words[${count / 4}]) {
  return words[${count / 4 - 1}] >> 24;
}

vec3 radianceOf(uint words[${count / 4}]) {
  int cap = int(capOf(words));
  vec3 radiance = texelFetch(lit, ivec2(0, cap), 0).rgb;
  for (int k = 0; k < ${count - 1}; ++k) {
    float coefficient = float((words[k >> 2] >> uint(8 * (k & 3))) & 255u) / 255.0;
    radiance += coefficient * texelFetch(lit, ivec2(k + 1, cap), 0).rgb;
  }
  return radiance;
}
`;
}

const HEAD = `
precision highp float;
precision highp int;
`;

/** Attributes of K bytes: `uvec4` of 16 and, where K is no multiple of that, a `uvec2` of the last 8. */
export function wordAttributes(count) {
  const attributes = [];
  for (let first = 0; first < count; first += 16) {
    attributes.push({ name: `words${first / 16}`, offset: first / 4, size: Math.min(16, count - first) / 4 });
  }
  return attributes;
}

function readWords(count) {
  const lines = [`uint words[${count / 4}];`];
  for (const { name, offset, size } of wordAttributes(count)) {
    for (let i = 0; i < size; ++i) lines.push(`words[${offset + i}] = ${name}[${i}];`);
  }
  return lines.join("\n  ");
}

/**
 * @param {object} kind
 * @param {number} kind.count - Bytes of a receiver.
 * @param {boolean} kind.perPixel - Whether reflectance is multiplied where it is seen, as textures need it.
 * @param {boolean} kind.hasReflectance - Else it is one.
 * @param {boolean} kind.hasFixed - Whether lamps shine that no map turns.
 */
export function transferVertex({ count, perPixel, hasReflectance, hasFixed }) {
  const attributes = wordAttributes(count).map(({ name, size }) => `in uvec${size} ${name};`);
  return `${HEAD}
uniform mat4 modelViewMatrix;
uniform mat4 projectionMatrix;
uniform float lamps;
in vec3 position;
${attributes.join("\n")}
${hasReflectance ? "in vec3 reflectance;" : "const vec3 reflectance = vec3(1.0);"}
${hasFixed ? "in vec3 fixedRadiance;" : "const vec3 fixedRadiance = vec3(0.0);"}
${perPixel ? "in vec2 uv;\nout vec2 place;\nout vec3 factor;" : ""}
out vec3 radiance;
invariant gl_Position;
${radianceSum(count)}
void main() {
  ${readWords(count)}
  radiance = radianceOf(words) + lamps * fixedRadiance;
  ${perPixel ? "place = uv;\n  factor = reflectance;" : "radiance *= reflectance;"}
  gl_Position = projectionMatrix * (modelViewMatrix * vec4(position, 1.0));
}
`;
}

/**
 * Backs of faces hide what is behind them and let the background through, as in Python's pictures: no light is known
 * there.
 */
export function transferFragment({ perPixel, hasTexture }) {
  const colour = hasTexture ? "factor * texture(image, place).rgb" : "factor";
  return `${HEAD}
in vec3 radiance;
${perPixel ? "in vec2 place;\nin vec3 factor;" : ""}
${hasTexture ? "uniform sampler2D image;" : ""}
out vec4 pixel;
void main() {
  vec3 light = radiance${perPixel ? ` * clamp(${colour}, 0.0, 1.0)` : ""};
  pixel = gl_FrontFacing ? vec4(light, 1.0) : vec4(0.0);
}
`;
}

/** A triangle that covers the picture; `at` is 0 to 1 from its lower left. */
export const PICTURE_VERTEX = `${HEAD}
in vec3 position;
out vec2 at;
void main() {
  at = 0.5 + 0.5 * position.xy;
  gl_Position = vec4(position.xy, 0.0, 1.0);
}
`;

/** The sum so far and one frame more, times its weight. */
export const ADDING_FRAGMENT = `${HEAD}
uniform sampler2D sum;
uniform sampler2D frame;
uniform float weight;
uniform bool first;
out vec4 pixel;
void main() {
  ivec2 here = ivec2(gl_FragCoord.xy);
  vec4 before = first ? vec4(0.0) : texelFetch(sum, here, 0);
  pixel = before + weight * texelFetch(frame, here, 0);
}
`;
