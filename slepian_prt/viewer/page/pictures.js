// Pictures of 8 bits as maps, decoded by the browser, where Python's lighting/formats/pictures.py decodes them itself.

import { MapError, checkShape, makeTexels } from "#mapChecks";
import { inPieces } from "#tasks";

/** Linear light from an sRGB value in [0, 1] (IEC 61966-2-1). */
function decodeSrgb(value) {
  return value <= 0.04045 ? value / 12.92 : ((value + 0.055) / 1.055) ** 2.4;
}

/**
 * A PNG, JPEG, WebP, … as linear light in [0, 1]: turned upright, and brought to sRGB, by the browser.
 *
 * @param {Uint8Array} bytes
 * @param {boolean} anyShape
 * @returns {Promise<{width: number, height: number, data: Float32Array, notes: string[]}>}
 */
export async function readPicture(bytes, anyShape) {
  const notes = checkPng(bytes);
  let bitmap;
  try {
    bitmap = await createImageBitmap(new Blob([bytes]), { premultiplyAlpha: "none" });
  } catch {
    throw new Error("it is of no kind that is known, or damaged");
  }
  const { width, height } = bitmap;
  checkShape(width, height, anyShape);
  const data = makeTexels(width, height), table = Float32Array.from({ length: 256 }, (_, i) => decodeSrgb(i / 255));
  const canvas = new OffscreenCanvas(width, 1).getContext("2d", { willReadFrequently: true });
  await inPieces(height, row => {
    canvas.globalCompositeOperation = "copy";
    canvas.drawImage(bitmap, 0, -row);
    const line = canvas.getImageData(0, 0, width, 1).data;
    for (let i = 0, at = 3 * width * row; i < line.length; i += 4, at += 3) {
      if (line[i + 3] < 255) throw transparent();
      for (let colour = 0; colour < 3; colour++) data[at + colour] = table[line[i + colour]];
    }
  });
  bitmap.close();
  return { width, height, data, notes };
}

function transparent() {
  return new MapError("is transparent in places, where browsers change colours; write it opaque");
}

/** Notes on a PNG; throws for one of a range that browsers would compress. Nothing for what is none. */
function checkPng(bytes) {
  if (!String.fromCharCode(...bytes.subarray(1, 4)).startsWith("PNG")) return [];
  const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength), notes = [];
  for (let at = 8; at + 8 < bytes.length; at += 12 + view.getUint32(at)) {
    const kind = String.fromCharCode(...bytes.subarray(at + 4, at + 8));
    if (kind === "IHDR" && bytes[at + 16] === 16) notes.push("of its 16 bits browsers read 8");
    const range = kind === "cICP" ? { 16: "PQ", 18: "HLG" }[bytes[at + 9]] : undefined;
    if (range) throw new MapError(`is a PNG encoded as ${range}, which is not read; convert it to .exr`);
    if (kind === "IDAT") break;
  }
  return notes;
}
