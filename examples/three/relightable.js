// A .glb of `slepian-prt export` in three.js: transfer from its attributes or its texture, relit in the vertex shader.

import * as THREE from "three";

// Radiance of a white vertex, from its K numbers and the table that the light makes of the functions of all caps.
export const RADIANCE = /* glsl */ `
uniform highp sampler2D table;  // K wide, C high

#ifdef FROM_TEXTURE
attribute vec2 uv2;
uniform highp sampler2D coefficients;  // three numbers to a texel, TEXELS for each vertex
float number(int k) {
  ivec2 first = ivec2(uv2 * vec2(textureSize(coefficients, 0)));
  return round(255.0 * texelFetch(coefficients, first + ivec2(k / 3, 0), 0)[k % 3]);
}
#else
ATTRIBUTES
float number(int k) { vec4 all[K / 4] = vec4[](NAMES); return all[k / 4][k % 4]; }
#endif

#ifdef LAMPS
attribute vec3 _lamps;
uniform float lamps;
#endif

vec3 radiance() {
  int cap = int(number(K - 1) + 0.5);
  vec3 sum = texelFetch(table, ivec2(0, cap), 0).rgb;
  for (int k = 1; k < K; k++) sum += number(k - 1) / 255.0 * texelFetch(table, ivec2(k, cap), 0).rgb;
  #ifdef LAMPS
  sum += lamps * _lamps;
  #endif
  return sum;
}
`;

const VERTEX = /* glsl */ `
RADIANCE
varying vec3 lit;
varying vec2 place;
#ifdef COLOURED
attribute vec3 color;
#endif
void main() {
  lit = radiance();
  #ifdef COLOURED
  lit *= color;
  #endif
  place = uv;
  gl_Position = projectionMatrix * modelViewMatrix * vec4(position, 1.0);
}
`;

const FRAGMENT = /* glsl */ `
uniform vec3 diffuse;
uniform float exposure;
#ifdef USE_IMAGE
uniform sampler2D image;
#endif
varying vec3 lit;
varying vec2 place;
void main() {
  vec3 reflected = diffuse * lit;
  #ifdef USE_IMAGE
  reflected *= texture(image, place).rgb;
  #endif
  gl_FragColor = vec4(exposure * max(reflected, 0.0), 1.0);
  #include <colorspace_fragment>
}
`;

/**
 * Give all meshes of a loaded file materials that relight them.
 *
 * @param {object} gltf - What GLTFLoader gives.
 * @returns {Promise<Relightable>}
 */
export async function makeRelightable(gltf) {
  const told = gltf.userData.slepian_prt;
  if (told?.kind !== "transfer") throw new Error("this .glb is not one that slepian-prt export has written");
  const [halves, zeros, coefficients] = await Promise.all([
    gltf.parser.getDependency("bufferView", told.functions.bufferView).then(bytes => new Uint16Array(bytes)),
    gltf.parser.getDependency("bufferView", told.zeros.bufferView).then(bytes => new Float32Array(bytes)),
    told.coefficients.in === "texture" ? gltf.parser.getDependency("texture", told.coefficients.texture) : null,
  ]);
  return new Relightable(gltf.scene, told, Float32Array.from(halves, THREE.DataUtils.fromHalfFloat), zeros, coefficients);
}

/** A model and its functions. */
export class Relightable {
  constructor(scene, told, functions, zeros, coefficients) {
    this.told = told;
    this.functions = functions;
    this.zeros = zeros;
    const { bytesPerVertex: width, caps: height } = told;
    const options = [THREE.RGBAFormat, THREE.FloatType];
    this.table = new THREE.DataTexture(new Float32Array(4 * width * height), width, height, ...options);
    this.uniforms = { table: { value: this.table }, exposure: { value: 1 }, lamps: { value: 1 } };
    if (coefficients) {
      coefficients.colorSpace = THREE.NoColorSpace;
      coefficients.generateMipmaps = false;
      this.uniforms.coefficients = { value: coefficients };
    }
    this.meshes = [];
    scene.traverse(object => {
      if (!object.isMesh) return;
      object.material = this.#material(object);
      this.meshes.push(object);
    });
  }

  /**
   * Let a light shine.
   *
   * @param {Float64Array} light - 3 (L+1)², in the axes of the model: red, then green, then blue.
   */
  setLight(light) {
    const { bytesPerVertex: K, caps: C, channels, bandlimit } = this.told;
    const size = (bandlimit + 1) ** 2, table = this.table.image.data;
    for (let cap = 0; cap < C; cap++) {
      for (let c = 0; c < 3; c++) {
        const own = channels === 3 ? c : 0;
        let mean = 0;
        for (let k = K - 1; k >= 0; k--) {
          const first = ((cap * K + k) * channels + own) * size;
          let sum = 0;
          for (let i = 0; i < size; i++) sum += this.functions[first + i] * light[c * size + i];
          if (k > 0) mean -= this.zeros[cap * (K - 1) + k - 1] * sum;
          table[4 * (cap * K + k) + c] = k > 0 ? sum : sum + mean;
        }
      }
    }
    this.table.needsUpdate = true;
  }

  /**
   * From a map to the axes of the model, whose nodes may turn it.
   *
   * @param {number} turn - By which the map is turned about y in the world, counter-clockwise seen from above.
   * @returns {number[]} A rotation, 9 numbers row by row.
   */
  fromMap(turn) {
    this.meshes[0].updateWorldMatrix(true, false);
    const toModel = new THREE.Matrix4().extractRotation(this.meshes[0].matrixWorld).transpose();
    const rotation = toModel.multiply(new THREE.Matrix4().makeRotationY(turn));
    return new THREE.Matrix3().setFromMatrix4(rotation).transpose().toArray();  // which gives columns
  }

  #material(mesh) {
    const given = mesh.material, { bytesPerVertex: K, coefficients } = this.told;
    const names = (coefficients.attributes ?? []).map(name => name.toLowerCase());
    const radiance = RADIANCE.replace("ATTRIBUTES", names.map(name => `attribute vec4 ${name};`).join("\n"))
      .replace("NAMES", names.join(", "));
    const attributes = mesh.geometry.attributes, defines = { K };
    if (names.length === 0) defines.FROM_TEXTURE = "";
    if ("_lamps" in attributes) defines.LAMPS = "";
    if ("color" in attributes) defines.COLOURED = "";
    if (given.map) defines.USE_IMAGE = "";
    return new THREE.ShaderMaterial({
      defines,
      uniforms: { ...this.uniforms, diffuse: { value: given.color }, image: { value: given.map } },
      vertexShader: VERTEX.replace("RADIANCE", radiance),
      fragmentShader: FRAGMENT,
      side: given.side,
    });
  }
}
