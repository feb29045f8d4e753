/** Shaders that draw receivers whose radiance is known, and that add pictures up. */

import { COLUMNS } from "#receivers";

const HEAD = `
precision highp float;
precision highp int;
`;

/**
 * @param {object} kind
 * @param {boolean} kind.perPixel - Whether reflectance is multiplied where it is seen, as textures need it.
 * @param {boolean} kind.hasReflectance - Else it is one.
 * @param {boolean} kind.hasFixed - Whether lamps shine that no map turns.
 */
export function transferVertex({ perPixel, hasReflectance, hasFixed }) {
  return `${HEAD}
uniform mat4 modelViewMatrix;
uniform mat4 projectionMatrix;
uniform float lamps;
uniform highp sampler2D white;
in vec3 position;
${hasReflectance ? "in vec3 reflectance;" : "const vec3 reflectance = vec3(1.0);"}
${hasFixed ? "in vec3 fixedRadiance;" : "const vec3 fixedRadiance = vec3(0.0);"}
${perPixel ? "in vec2 uv;\nout vec2 place;\nout vec3 factor;" : ""}
out vec3 radiance;
invariant gl_Position;
void main() {
  ivec2 texel = ivec2(gl_VertexID % ${COLUMNS}, gl_VertexID / ${COLUMNS});
  radiance = texelFetch(white, texel, 0).rgb + lamps * fixedRadiance;
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
