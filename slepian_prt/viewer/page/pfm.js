// Portable float maps: rows of float32 from the bottom up, as Python's lighting/formats/pfm.py reads them.

import { checkShape, makeTexels } from "#mapChecks";
import { inPieces } from "#tasks";

const HEADER = /^P([Ff])\s+(\d+)\s+(\d+)\s+([-+.\deE]+)\s/;

/**
 * A map, grey or in colours; the sign of its scale says the order of bytes, its size is a factor of the texels.
 *
 * @param {Uint8Array} bytes
 * @param {boolean} anyShape
 * @returns {Promise<{width: number, height: number, data: Float32Array, notes: string[]}>}
 */
export async function readPfm(bytes, anyShape) {
  const header = HEADER.exec(new TextDecoder("latin1").decode(bytes.subarray(0, 256)));
  if (!header) throw new Error("its header is none of a .pfm");
  const channels = header[1] === "F" ? 3 : 1;
  const width = Number(header[2]), height = Number(header[3]), scale = Number(header[4]);
  checkShape(width, height, anyShape);
  if (!Number.isFinite(scale) || scale === 0) throw new Error(`its scale is ${header[4]}`);
  if (bytes.length < header[0].length + 4 * channels * width * height) throw new Error("it is cut short");
  const view = new DataView(bytes.buffer, bytes.byteOffset + header[0].length), factor = Math.fround(Math.abs(scale));
  const data = makeTexels(width, height);
  await inPieces(height, row => {
    const stored = height - 1 - row;
    for (let i = 0; i < 3 * width; i++) {
      const place = channels === 3 ? 3 * width * stored + i : width * stored + Math.floor(i / 3);
      data[3 * width * row + i] = view.getFloat32(4 * place, scale < 0) * factor;
    }
  });
  return { width, height, data, notes: [] };
}
