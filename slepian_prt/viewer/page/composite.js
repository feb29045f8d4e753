/** The last pass: radiance of the receivers, what is behind them, exposure and tone mapping, as Python's pictures. */

import { GLSL3, NoBlending, RawShaderMaterial, Vector2, Vector3 } from "three-kit";
import { COLOUR_MAP } from "#colours";
import { PICTURE_VERTEX } from "#shaders";
import { TONE } from "#tone";

/** What stands behind the model, as the shader numbers it. */
export const BEHIND = { map: 0, plain: 1, transparent: 2, checker: 3 };

// A map is part of the picture before it is exposed; a plain colour is shown as it is: see `Picture.over` and
// `tone_map` of pictures.py.
const COMPOSITE = `
precision highp float;
precision highp int;
in vec2 at;
uniform sampler2D radiance;
uniform sampler2D other;
uniform sampler2D backdrop;
uniform bool isDifference;
uniform float scale;
uniform int behind;
uniform vec3 plain;
uniform float largest;
uniform vec3 light;
uniform vec3 dark;
uniform float square;
out vec4 shown;
${TONE}
${COLOUR_MAP}

vec4 difference(vec4 one, vec4 two) {
  float apart = dot(abs(one.rgb - two.rgb), vec3(1.0 / 3.0));
  vec3 colour = colourOf(clamp(apart / largest, 0.0, 1.0));
  return vec4(mix(plain, colour, clamp(one.a, 0.0, 1.0)), 1.0);
}

void main() {
  vec4 seen = texture(radiance, at);
  float alpha = clamp(seen.a, 0.0, 1.0);
  if (isDifference) {
    shown = difference(seen, texture(other, at));
    return;
  }
  if (behind == ${BEHIND.map}) {
    vec3 whole = seen.rgb + (1.0 - alpha) * texture(backdrop, at).rgb;
    shown = vec4(encodeSrgb(rollOff(scale * whole)), 1.0);
  } else if (behind == ${BEHIND.plain}) {
    vec3 whole = rollOff(scale * seen.rgb) + (1.0 - alpha) * plain;
    shown = vec4(clamp(encodeSrgb(whole), 0.0, 1.0), 1.0);
  } else {
    vec3 opaque = encodeSrgb(rollOff(scale * seen.rgb / max(alpha, 1e-4)));
    vec2 cell = floor(gl_FragCoord.xy / square);
    vec3 under = mod(cell.x + cell.y, 2.0) < 0.5 ? light : dark;
    shown = behind == ${BEHIND.transparent} ? vec4(opaque, alpha) : vec4(mix(under, opaque, alpha), 1.0);
  }
}
`;

/** The material of the last pass. Colours of the checkers are sRGB, `plain` is linear. */
export function compositeMaterial() {
  return new RawShaderMaterial({
    glslVersion: GLSL3,
    vertexShader: PICTURE_VERTEX,
    fragmentShader: COMPOSITE,
    blending: NoBlending,
    depthTest: false,
    depthWrite: false,
    uniforms: {
      radiance: { value: null },
      other: { value: null },
      backdrop: { value: null },
      isDifference: { value: false },
      scale: { value: 1 },
      behind: { value: BEHIND.plain },
      plain: { value: new Vector3(1, 1, 1) },
      largest: { value: 1 },
      light: { value: new Vector3(0.86, 0.86, 0.86) },
      dark: { value: new Vector3(0.74, 0.74, 0.74) },
      square: { value: 8 },
    },
  });
}
