// Headers of OpenEXR files, and one part with one image as a file that three.js' loader reads. The layout is that of
// "OpenEXR File Layout" in OpenEXR's documentation; Python's lighting/formats/exr_header.py reads the same.

// Bits of the version field.
const TILED = 0x200, LONG_NAMES = 0x400, DEEP = 0x800, SEVERAL = 0x1000;

const KINDS = ["uint", "half", "float"];

// Rows of a block, by compression.
const COMPRESSIONS = ["none", "RLE", "ZIPS", "ZIP", "PIZ", "PXR24", "B44", "B44A", "DWAA", "DWAB", "HTJ2K", "HTJ2K"];
const BLOCK_ROWS = { none: 1, RLE: 1, ZIPS: 1, ZIP: 16, PIZ: 32, PXR24: 16, B44: 32, B44A: 32, DWAA: 32, DWAB: 256 };

/** Whether bytes begin as OpenEXR does. */
export function isExr(bytes) {
  return bytes[0] === 0x76 && bytes[1] === 0x2f && bytes[2] === 0x31 && bytes[3] === 1;
}

/**
 * What the headers say, one for each part.
 *
 * @param {Uint8Array} bytes
 * @returns {object[]} name, view (of a part, empty if it has none), views (of layers, the default first), tiled, deep,
 *   cube, compression, channels ({name, kind, sampling}), data and display ({left, top, right, bottom, width, height}),
 *   chromaticities (8) or null, tiles ([width, height]) or null, several, chunks, end (of the header).
 * @throws {Error} A header that is cut short or damaged.
 */
export function readHeaders(bytes) {
  const view = viewOf(bytes), parts = [];
  try {
    const flags = view.getUint32(4, true), cursor = { at: 8 };
    while (!parts.length || (flags & SEVERAL && bytes[cursor.at])) parts.push(readHeader(bytes, flags, cursor));
  } catch {
    throw new Error("its header is cut short or damaged");
  }
  return parts;
}

function viewOf(bytes) {
  return new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
}

function readHeader(bytes, flags, cursor) {
  const view = viewOf(bytes), attributes = {};
  while (bytes[cursor.at]) {
    const name = readWord(bytes, cursor);
    readWord(bytes, cursor);
    const size = view.getUint32(cursor.at, true), begin = cursor.at + 4;
    if (begin + size > bytes.length) throw new RangeError();
    attributes[name] = bytes.subarray(begin, begin + size);
    cursor.at = begin + size;
  }
  cursor.at += 1;
  const text = name => new TextDecoder().decode(attributes[name] ?? new Uint8Array());
  const floats = value => Array.from({ length: value.length / 4 }, (_, i) => viewOf(value).getFloat32(4 * i, true));
  const type = text("type"), { chromaticities, chunkCount, tiles } = attributes;
  return {
    name: text("name"),
    view: text("view"),
    views: readStrings(attributes.multiView),
    tiled: type.includes("tile") || Boolean(flags & TILED),
    deep: type.startsWith("deep") || (Boolean(flags & DEEP) && !type),
    cube: attributes.envmap?.[0] === 1,
    compression: COMPRESSIONS[attributes.compression[0]] ?? `of kind ${attributes.compression[0]}`,
    channels: readChannels(attributes.channels),
    data: readWindow(attributes.dataWindow),
    display: readWindow(attributes.displayWindow),
    chromaticities: chromaticities ? floats(chromaticities) : null,
    tiles: tiles ? [viewOf(tiles).getUint32(0, true), viewOf(tiles).getUint32(4, true)] : null,
    several: Boolean(flags & SEVERAL),
    chunks: chunkCount ? viewOf(chunkCount).getInt32(0, true) : 0,
    end: cursor.at,
  };
}

/** A string that ends in a zero; moves the cursor after it. */
function readWord(bytes, cursor) {
  const end = bytes.indexOf(0, cursor.at);
  if (end < 0) throw new RangeError();
  const word = new TextDecoder().decode(bytes.subarray(cursor.at, end));
  cursor.at = end + 1;
  return word;
}

function readStrings(value) {
  const found = [];
  for (let at = 0; value && at < value.length;) {
    const size = viewOf(value).getUint32(at, true);
    found.push(new TextDecoder().decode(value.subarray(at + 4, at + 4 + size)));
    at += 4 + size;
  }
  return found;
}

function readChannels(value) {
  const found = [], cursor = { at: 0 }, view = viewOf(value);
  while (value[cursor.at]) {
    const name = readWord(value, cursor), kind = KINDS[view.getInt32(cursor.at, true)];
    if (!kind) throw new RangeError();
    const sampling = [view.getInt32(cursor.at + 8, true), view.getInt32(cursor.at + 12, true)];
    found.push({ name, kind, sampling });
    cursor.at += 16;
  }
  return found;
}

function readWindow(value) {
  const [left, top, right, bottom] = [0, 4, 8, 12].map(at => viewOf(value).getInt32(at, true));
  return { left, top, right, bottom, width: right - left + 1, height: bottom - top + 1 };
}

/**
 * The finest level of a part as a file of its own whose chosen channels are called R, G and B (or Y): three.js' loader
 * knows no other names, takes blocks in the order that they come in, and complains of attributes that it does not know.
 *
 * @param {Uint8Array} bytes
 * @param {object[]} parts Of `readHeaders`.
 * @param {number} number Of the part.
 * @param {object[]} chosen Three of its channels, or one.
 * @returns {Uint8Array}
 * @throws {Error} Pixels that are not all there.
 */
export function extractImage(bytes, parts, number, chosen) {
  const part = parts[number], { data, tiled, tiles } = part;
  const count = tiled
    ? Math.ceil(data.width / tiles[0]) * Math.ceil(data.height / tiles[1])
    : Math.ceil(data.height / BLOCK_ROWS[part.compression]);
  const before = parts.slice(0, number).reduce((sum, { chunks }) => sum + chunks, 0);
  const table = parts.at(-1).end + (part.several ? 1 : 0) + 8 * before;
  const beforeSize = tiled ? 16 : 4, view = viewOf(bytes);
  const blocks = [];
  try {
    for (let i = 0; i < count; i++) {
      const begin = Number(view.getBigUint64(table + 8 * i, true)) + (part.several ? 4 : 0);
      const size = beforeSize + 4 + view.getUint32(begin + beforeSize, true);
      if (begin < table || begin + size > bytes.length) throw new RangeError();
      blocks.push(bytes.subarray(begin, begin + size));
    }
  } catch {
    throw new Error("it is cut short");
  }
  const header = writeHeader(part, chosen);
  const file = new Uint8Array(header.length + 8 * count + blocks.reduce((sum, block) => sum + block.length, 0));
  file.set(header);
  let at = header.length + 8 * count; // a table of places that the loader skips
  for (const block of blocks) {
    file.set(block, at);
    at += block.length;
  }
  return file;
}

function writeHeader(part, chosen) {
  const written = [0x76, 0x2f, 0x31, 1];
  const put = (kind, ...values) => values.forEach(value => {
    const four = new Uint8Array(4);
    viewOf(four)[kind](0, value, true);
    written.push(...four);
  });
  const word = text => written.push(...new TextEncoder().encode(text), 0);
  const attribute = (name, type, size) => { word(name); word(type); put("setUint32", size); };
  put("setUint32", 2 | LONG_NAMES | (part.tiled ? TILED : 0));
  const names = part.channels.map((channel, i) => nameForLoader(channel, i, chosen));
  const size = names.reduce((sum, name) => sum + new TextEncoder().encode(name).length + 17, 1);
  attribute("channels", "chlist", size);
  part.channels.forEach(({ kind, sampling }, i) => {
    word(names[i]);
    put("setInt32", kind === "half" ? 1 : 2, 0, ...sampling); // integers, which the loader counts as nothing, as floats
  });
  written.push(0);
  attribute("compression", "compression", 1);
  written.push(COMPRESSIONS.indexOf(part.compression));
  for (const [name, window] of [["dataWindow", part.data], ["displayWindow", part.display]]) {
    attribute(name, "box2i", 16);
    put("setInt32", window.left, window.top, window.right, window.bottom);
  }
  if (part.tiled) {
    attribute("tiles", "tiledesc", 9);
    put("setUint32", ...part.tiles);
    written.push(0); // one level
  }
  written.push(0);
  return new Uint8Array(written);
}

/** R, G, B or Y for what is chosen; for others a name that the loader passes over, ending in what DWA goes by. */
function nameForLoader(channel, i, chosen) {
  const place = chosen.indexOf(channel);
  if (place >= 0) return chosen.length === 3 ? "RGB"[place] : "Y";
  return `other${i}.${channel.name.split(".").at(-1)}`;
}
