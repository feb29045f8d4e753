/** The map behind a model: relighting/drawing/backdrop.py, drawn by the GPU. */

import { ClampToEdgeWrapping, DataTexture, FloatType, LinearFilter, Matrix3, RepeatWrapping, RGBAFormat, Vector3 } from "three-kit";
import { pictureMaterial } from "#passes";

// The largest number of float16: brighter texels are white in any picture.
const BRIGHTEST = 65504;

/** GLSL: radiance of a map from a direction of the world; columns are centred, rows stand on the poles. */
export const LOOK_UP = `
uniform highp sampler2D map;
uniform mat3 toMap;

vec3 lookUp(vec3 direction) {
  vec3 local = normalize(toMap * direction);
  float u = atan(local.x, -local.z) / 6.283185307179586;
  float v = acos(clamp(local.y, -1.0, 1.0)) / 3.141592653589793;
  float rows = float(textureSize(map, 0).y);
  return textureLod(map, vec2(u, (v * (rows - 1.0) + 0.5) / rows), 0.0).rgb;
}
`;

// Several looks per pixel along each side: small suns are not missed between the middles of pixels.
const BACKDROP = `
precision highp float;
precision highp int;
in vec2 at;
uniform vec3 corner;
uniform vec3 across;
uniform vec3 up;
uniform vec2 pixel;
uniform int looks;
out vec4 seen;
${LOOK_UP}
void main() {
  vec3 total = vec3(0.0);
  for (int i = 0; i < looks; ++i) {
    for (int j = 0; j < looks; ++j) {
      vec2 place = at + ((vec2(i, j) + 0.5) / float(looks) - 0.5) * pixel;
      total += lookUp(corner + place.x * across + place.y * up);
    }
  }
  seen = vec4(total / float(looks * looks), 1.0);
}
`;

/** The uniforms that `LOOK_UP` needs. */
export function mapUniforms() {
  return { map: { value: null }, toMap: { value: new Matrix3() } };
}

/**
 * Texels as the shader looks them up.
 *
 * @param {{width: number, height: number, data: Float32Array}} map - RGB, from the top.
 * @returns {DataTexture} In float16.
 */
export function mapTexture({ width, height, data }) {
  const texels = new Float32Array(4 * width * height);
  for (let i = 0, j = 0; j < texels.length; i += 3, j += 4) {
    texels[j] = Math.min(data[i], BRIGHTEST);
    texels[j + 1] = Math.min(data[i + 1], BRIGHTEST);
    texels[j + 2] = Math.min(data[i + 2], BRIGHTEST);
  }
  const texture = new DataTexture(texels, width, height, RGBAFormat, FloatType);
  texture.internalFormat = "RGBA16F"; // the GPU filters it everywhere, float32 on some machines only
  texture.minFilter = texture.magFilter = LinearFilter;
  texture.wrapS = RepeatWrapping;
  texture.wrapT = ClampToEdgeWrapping;
  texture.generateMipmaps = false;
  texture.needsUpdate = true;
  return texture;
}

/** A material that draws a map as a camera sees it. */
export function backdropMaterial() {
  return pictureMaterial(BACKDROP, {
    ...mapUniforms(),
    corner: { value: new Vector3() },
    across: { value: new Vector3() },
    up: { value: new Vector3() },
    pixel: { value: [0, 0] },
    looks: { value: 1 },
  });
}

/**
 * Aim the backdrop.
 *
 * @param {object} uniforms - Of `backdropMaterial`.
 * @param {import("three-kit").PerspectiveCamera} camera
 * @param {{left: number, right: number, top: number, bottom: number}} frame - As of `frameOf`.
 * @param {number[]} size - Pixels across and down.
 */
export function aimBackdrop(uniforms, camera, frame, size) {
  uniforms.corner.value.set(frame.left, frame.bottom, -1).applyQuaternion(camera.quaternion);
  uniforms.across.value.set(frame.right - frame.left, 0, 0).applyQuaternion(camera.quaternion);
  uniforms.up.value.set(0, frame.top - frame.bottom, 0).applyQuaternion(camera.quaternion);
  uniforms.pixel.value = [1 / size[0], 1 / size[1]];
}
