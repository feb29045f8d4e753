/** The last pass: radiance of the receivers, what is behind them, exposure and tone mapping, as Python's pictures. */

import { Vector3, Vector4 } from "three-kit";
import { COLOUR_MAP } from "#colours";
import { pictureMaterial } from "#passes";
import { TONE } from "#tone";

/** What is shown: radiance, the difference of two, or colours as they are; as the shader numbers it. */
export const SHOWN = { picture: 0, difference: 1, colours: 2 };

/** What stands behind the model, as the shader numbers it. */
export const BEHIND = { map: 0, plain: 1, transparent: 2, checker: 3, film: 4 };

// A map is part of the picture before it is exposed; a plain colour is shown as it is: see `Picture.over` and
// `tone_map` of pictures.py.
const COMPOSITE = `
precision highp float;
precision highp int;
in vec2 at;
uniform sampler2D radiance;
uniform sampler2D other;
uniform sampler2D backdrop;
uniform int kind;
uniform vec4 window;
uniform float scale;
uniform int behind;
uniform vec3 plain;
uniform float largest;
uniform vec3 light;
uniform vec3 dark;
uniform float square;
uniform vec3 surround;
out vec4 shown;
${TONE}
${COLOUR_MAP}

vec4 difference(vec4 one, vec4 two) {
  float apart = dot(abs(one.rgb - two.rgb), vec3(1.0 / 3.0));
  vec3 colour = colourOf(clamp(apart / largest, 0.0, 1.0));
  return vec4(mix(encodeSrgb(plain), colour, clamp(one.a, 0.0, 1.0)), 1.0);
}

vec4 picture(vec4 seen, float alpha, vec2 place) {
  if (behind == ${BEHIND.map}) {
    vec3 whole = seen.rgb + (1.0 - alpha) * texture(backdrop, place).rgb;
    return vec4(encodeSrgb(rollOff(scale * whole)), 1.0);
  }
  if (behind == ${BEHIND.film}) {
    vec3 whole = seen.rgb + texture(backdrop, place).rgb;
    return vec4(encodeSrgb(rollOff(scale * whole)), 1.0);
  }
  if (behind == ${BEHIND.plain}) {
    vec3 whole = rollOff(scale * seen.rgb) + (1.0 - alpha) * plain;
    return vec4(clamp(encodeSrgb(whole), 0.0, 1.0), 1.0);
  }
  vec3 opaque = encodeSrgb(rollOff(scale * seen.rgb / max(alpha, 1e-4)));
  vec2 cell = floor(gl_FragCoord.xy / square);
  vec3 under = mod(cell.x + cell.y, 2.0) < 0.5 ? light : dark;
  return behind == ${BEHIND.transparent} ? vec4(opaque, alpha) : vec4(mix(under, opaque, alpha), 1.0);
}

void main() {
  // Where the picture of a film lies in the canvas; that of a model fills it.
  vec2 place = (at - window.xy) / window.zw;
  if (any(lessThan(place, vec2(0.0))) || any(greaterThan(place, vec2(1.0)))) {
    shown = vec4(surround, 1.0);
    return;
  }
  vec4 seen = texture(radiance, place);
  float alpha = clamp(seen.a, 0.0, 1.0);
  if (kind == ${SHOWN.difference}) shown = difference(seen, texture(other, place));
  else if (kind == ${SHOWN.colours}) shown = vec4(encodeSrgb(max(seen.rgb + (1.0 - alpha) * plain, 0.0)), 1.0);
  else shown = picture(seen, alpha, place);
}
`;

/** The material of the last pass. Colours of the checkers are sRGB, `plain` is linear. */
export function compositeMaterial() {
  return pictureMaterial(COMPOSITE, {
    radiance: { value: null },
    other: { value: null },
    backdrop: { value: null },
    kind: { value: SHOWN.picture },
    window: { value: new Vector4(0, 0, 1, 1) },
    scale: { value: 1 },
    behind: { value: BEHIND.plain },
    plain: { value: new Vector3(1, 1, 1) },
    largest: { value: 1 },
    light: { value: new Vector3(0.86, 0.86, 0.86) },
    dark: { value: new Vector3(0.78, 0.78, 0.78) },
    square: { value: 8 },
    surround: { value: new Vector3() },
  });
}
