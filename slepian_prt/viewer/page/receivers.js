/**
 * Radiance of all receivers by one pass of the GPU: docs/runtime-format.md has the same sum in words.
 *
 * It is worked out once for each light and not in each picture: those of a picture at rest are many, and a vertex is
 * shaded for several faces.
 */

import { DataTexture, NearestFilter, RGBAIntegerFormat, UnsignedIntType } from "three-kit";
import { pictureMaterial, radianceTarget } from "#passes";

/** Receivers of a row of textures, if they are no pixels. */
export const COLUMNS = 2048;

/**
 * GLSL of the sum of a receiver: its bytes times the lit functions of its cap.
 *
 * The bytes are fetched as 32-bit words, four to each, lowest first; the last byte is the number of the cap. A texel
 * (k, c) of `lit` has the red, green and blue of function k of cap c under the light.
 *
 * @param {number} count - Bytes of a receiver, K: a multiple of 8.
 * @returns {string} `readWords(ivec2 place, int rows)`, then `capOfWords()` and `radianceOfWords()`.
 */
export function radianceSum(count) {
  const reads = Array.from({ length: Math.ceil(count / 16) }, (_, layer) => {
    const parts = Array.from({ length: Math.min(4, (count - 16 * layer) / 4) }, (_, i) => (
      `words[${4 * layer + i}] = part${layer}[${i}];`
    ));
    return `uvec4 part${layer} = texelFetch(bytes, place + ivec2(0, ${layer} * rows), 0);\n  ${parts.join("\n  ")}`;
  });
  return `
uniform highp usampler2D bytes;
uniform highp sampler2D lit;
uint words[${count / 4}];

void readWords(ivec2 place, int rows) {
  ${reads.join("\n  ")}
}

int capOfWords() {
  return int(words[${count / 4 - 1}] >> 24);
}

vec3 radianceOfWords() {
  int cap = capOfWords();
  vec3 radiance = texelFetch(lit, ivec2(0, cap), 0).rgb;
  for (int k = 0; k < ${count - 1}; ++k) {
    float coefficient = float((words[k >> 2] >> uint(8 * (k & 3))) & 255u) / 255.0;
    radiance += coefficient * texelFetch(lit, ivec2(k + 1, cap), 0).rgb;
  }
  return radiance;
}
`;
}

/**
 * Bytes of receivers as a texture: 16 bytes of each, row by row, and below these the next 16.
 *
 * @param {{functions: number, bytes: Uint8Array}} model
 * @param {number} columns
 * @returns {{texture: DataTexture, rows: number}}
 */
export function wordTexture({ functions, bytes }, columns) {
  const count = bytes.length / functions;
  const rows = Math.ceil(count / columns);
  const layers = Math.ceil(functions / 16);
  const words = new Uint8Array(16 * columns * rows * layers);
  if (functions === 16) words.set(bytes);
  else {
    for (let layer = 0; layer < layers; ++layer) {
      const size = Math.min(16, functions - 16 * layer);
      const first = 16 * layer * columns * rows;
      for (let i = 0; i < count; ++i) {
        const from = i * functions + 16 * layer;
        for (let j = 0; j < size; ++j) words[first + 16 * i + j] = bytes[from + j];
      }
    }
  }
  const data = new Uint32Array(words.buffer); // little-endian, as all that runs WebGL is
  const texture = new DataTexture(data, columns, rows * layers, RGBAIntegerFormat, UnsignedIntType);
  texture.minFilter = texture.magFilter = NearestFilter;
  texture.needsUpdate = true;
  return { texture, rows };
}

const fragment = (count) => `
precision highp float;
precision highp int;
uniform int rows;
out vec4 radiance;
${radianceSum(count)}
void main() {
  readWords(ivec2(gl_FragCoord.xy), rows);
  radiance = vec4(radianceOfWords(), 1.0);
}
`;

/** Radiance of unit albedo of the receivers of a model, under lights that it is asked for. */
export class ReceiverRadiance {
  constructor(model) {
    const { texture, rows } = wordTexture(model, COLUMNS);
    this._rows = rows;
    this._material = pictureMaterial(fragment(model.functions), {
      bytes: { value: texture }, lit: { value: null }, rows: { value: rows },
    });
    this._known = new WeakMap();
  }

  /**
   * A texture with the radiance of receiver i in column i mod `COLUMNS`, row i / `COLUMNS`.
   *
   * @param {import("#passes").Passes} passes
   * @param {DataTexture} lit - K x C; worked out anew when it changed.
   */
  under(passes, lit) {
    const known = this._known.get(lit) ?? this._make(passes, lit);
    if (known.version !== lit.version) {
      this._material.uniforms.lit.value = lit;
      passes.draw(this._material, known.target);
      known.version = lit.version;
    }
    return known.target.texture;
  }

  _make(passes, lit) {
    const target = radianceTarget({ isExact: passes.isExact, isSmooth: false });
    target.setSize(COLUMNS, this._rows);
    lit.addEventListener("dispose", () => target.dispose());
    const known = { target, version: -1 };
    this._known.set(lit, known);
    return known;
  }
}
