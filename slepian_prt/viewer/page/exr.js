// OpenEXR files, whose pixels three.js' loader decodes.

import { extractImage, readHeaders } from "#exrHeader";
import { chooseLayer } from "#exrLayers";
import { MapError, checkShape, checkSize, makeTexels } from "#mapChecks";
import { toSrgb } from "#primaries";
import { inPieces } from "#tasks";

/**
 * The light that a file holds: scanlines or tiles (the finest level), of one part or several. The map is the display
 * window. What of it the data window does not hold is black, and what it holds beyond is cut off. Alpha is ignored,
 * chromaticities are followed.
 *
 * @param {Uint8Array} bytes
 * @param {boolean} anyShape
 * @returns {Promise<{width: number, height: number, data: Float32Array, notes: string[]}>}
 */
export async function readExr(bytes, anyShape) {
  const parts = readHeaders(bytes), layer = chooseLayer(parts), part = parts[layer.part];
  if (part.cube) {
    throw new MapError("is an environment map as the six faces of a cube; convert it to latitude-longitude");
  }
  checkSize(part.data.width, part.data.height);
  checkShape(part.display.width, part.display.height, anyShape);
  checkLoadable(part, layer.channels);
  const convert = part.chromaticities && layer.channels.length === 3 ? toSrgb(part.chromaticities) : null;
  const stored = await decode(extractImage(bytes, parts, layer.part, layer.channels));
  return { ...await placeInDisplay(stored, part, convert), notes: layer.notes };
}

/** Throws for what the loader would read wrongly, or not at all, and Python would read. */
function checkLoadable({ compression, channels }, chosen) {
  const others = channels.filter(channel => !chosen.includes(channel));
  const alike = list => new Set(list.map(({ kind }) => kind)).size <= 1;
  const remedy = "write it again with R, G and B alone, compressed as ZIP";
  const beside = `holds channels beside its colours (${others.map(({ name }) => name).join(", ")}) that pages cannot `
    + `tell from them in ${compression}; ${remedy}`;
  if (/HTJ2K|of kind/.test(compression)) {
    throw new MapError(`its compression (${compression}) is not read in pages; ${remedy}`);
  }
  if (!alike(chosen)) throw new MapError(`its colours are of different types; ${remedy}`);
  if (others.some(({ sampling }) => sampling[0] !== 1 || sampling[1] !== 1)) throw new MapError(beside);
  // In these the loader takes all channels for one type, or knows no integers.
  if (compression === "PIZ" && !alike(channels.map(({ kind }) => ({ kind: kind === "uint" ? "float" : kind })))) {
    throw new MapError(beside);
  }
  if (compression === "PXR24" && others.some(({ kind }) => kind === "uint")) throw new MapError(beside);
  if (compression.startsWith("DWA")) {
    // Coded by names: one set of colours, and one alpha.
    const last = channels.map(({ name }) => name.split(".").at(-1)).filter(name => name !== "A").join("");
    if (!alike(channels) || others.length > 1 || !["BGR", "Y"].includes(last)) throw new MapError(beside);
  }
}

/** Texels of the display window, from the top, of RGBA texels of the data window, from the bottom. */
async function placeInDisplay(stored, { data: window, display }, convert) {
  const { width, height } = display, texels = makeTexels(width, height);
  await inPieces(height, row => {
    const from = row + display.top - window.top;
    if (from < 0 || from >= window.height) return;
    const begin = Math.max(0, window.left - display.left), end = Math.min(width, window.right - display.left + 1);
    for (let column = begin; column < end; column++) {
      const at = 4 * ((window.height - 1 - from) * window.width + column + display.left - window.left);
      const to = 3 * (width * row + column);
      for (let i = 0; i < 3; i++) {
        texels[to + i] = convert
          ? convert[3 * i] * stored[at] + convert[3 * i + 1] * stored[at + 1] + convert[3 * i + 2] * stored[at + 2]
          : stored[at + i];
      }
    }
  });
  return { width, height, data: texels };
}

// Decoding takes up to seconds and cannot be interrupted: it goes to a thread of its own.
const WORKER = `
  onmessage = ({ data: file }) => {
    try {
      const { data } = new kit.EXRLoader().setDataType(kit.FloatType).parse(file.buffer);
      postMessage({ texels: data }, [data.buffer]);
    } catch {
      postMessage({ damaged: true });
    }
  };
  postMessage({ ready: true });`;

/** RGBA texels (4 W H) of the data window, from the bottom. */
async function decode(file) {
  const worker = await startWorker();
  if (!worker) return decodeHere(file);
  try {
    return await new Promise((resolve, reject) => {
      worker.onmessage = ({ data }) => (data.texels ? resolve(data.texels) : reject(damaged()));
      worker.onerror = () => reject(damaged());
      worker.postMessage(file, [file.buffer]);
    });
  } finally {
    worker.terminate();
  }
}

/** A worker that is ready; null where a browser gives pages from a disk none. */
async function startWorker() {
  try {
    const url = URL.createObjectURL(new Blob([await kitAsScript(), WORKER], { type: "text/javascript" }));
    const worker = new Worker(url);
    return await new Promise(resolve => {
      worker.onmessage = () => resolve(worker);
      worker.onerror = () => resolve(null);
    }).finally(() => URL.revokeObjectURL(url));
  } catch {
    return null;
  }
}

/** The vendored module as a script with a constant `kit`: workers of pages from a disk may not be modules. */
async function kitAsScript() {
  const source = await (await fetch(import.meta.resolve("three-kit"))).text();
  return source.replace(/export\s*\{([^}]*)\};?\s*$/, (_, names) => {
    return `const kit = {${names.replace(/([\w$]+) as ([\w$]+)/g, "$2: $1")}};`;
  });
}

async function decodeHere(file) {
  const { EXRLoader, FloatType } = await import("three-kit");
  try {
    return new EXRLoader().setDataType(FloatType).parse(file.buffer).data;
  } catch {
    throw damaged();
  }
}

function damaged() {
  return new Error("its pixels are cut short or damaged");
}
