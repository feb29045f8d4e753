// Radiance pictures (.hdr, .pic), read as Python's lighting/formats/radiance.py reads them: a texel is m 2^(e - 136).

import { checkShape, makeTexels } from "#mapChecks";
import { toSrgb, xyzToSrgb } from "#primaries";
import { inPieces } from "#tasks";

// Scanlines of other lengths are never stored by component.
const SHORTEST = 8, LONGEST = 32767;

const LONGEST_HEADER = 2 ** 20;

const RESOLUTION = /^\s*([-+])([XY])\s+(\d+)\s+([-+])([XY])\s+(\d+)\s*$/;

/**
 * The radiance that a picture was made from: EXPOSURE and COLORCORR, each as often as it is there, are divided out;
 * PRIMARIES and XYZ are brought to sRGB; all eight orders of texels, and both run-length codings or none, are read.
 *
 * @param {Uint8Array} bytes
 * @param {boolean} anyShape
 * @returns {Promise<{width: number, height: number, data: Float32Array, notes: string[]}>}
 */
export async function readHdr(bytes, anyShape) {
  const header = parseHeader(bytes);
  const { width, height, byColumn } = header;
  checkShape(width, height, anyShape);
  const [count, length] = byColumn ? [width, height] : [height, width];
  if (bytes.length - header.size < 4 * count) throw cutShort();
  const data = makeTexels(width, height), line = new Uint8Array(4 * length);
  const write = texelWriter(header, data);
  let at = header.size;
  await inPieces(count, number => {
    at = readScanline(bytes, at, line, number);
    for (let i = 0; i < length; i++) {
      const row = byColumn ? i : number, column = byColumn ? number : i;
      write(line, 4 * i, header.upsideDown ? height - 1 - row : row, header.mirrored ? width - 1 - column : column);
    }
  });
  return { width, height, data, notes: header.notes };
}

function cutShort() {
  return new Error("it is cut short");
}

/** Lines up to that of the resolution; later ones of EXPOSURE and COLORCORR multiply earlier ones. */
function parseHeader(bytes) {
  const applied = [1, 1, 1], notes = [];
  let matrix = [1, 0, 0, 0, 1, 0, 0, 0, 1], kind = "32-bit_rle_rgbe", at = 0, found = null;
  while (!found) {
    const end = bytes.indexOf(10, at);
    if (end < 0 || end >= LONGEST_HEADER) throw new Error("its header has no line of resolution, as -Y 512 +X 1024");
    const line = new TextDecoder("latin1").decode(bytes.subarray(at, end)).replace(/\r+$/, "");
    at = end + 1;
    found = RESOLUTION.exec(line);
    if (found && found[2] === found[5]) found = null;
    const [name, ...rest] = line.split("="), value = rest.join("=");
    if (name === "EXPOSURE") {
      const [exposure] = numbers(name, value, 1);
      applied.forEach((_, i) => { applied[i] *= exposure; });
    } else if (name === "COLORCORR") {
      numbers(name, value, 3).forEach((factor, i) => { applied[i] *= factor; });
    } else if (name === "PRIMARIES") {
      matrix = toSrgb(numbers(name, value, 8, false)) ?? [1, 0, 0, 0, 1, 0, 0, 0, 1];
    } else if (name === "FORMAT") {
      kind = value.trim();
    } else if (name === "GAMMA" && !["1", "1.0", "1.00"].includes(value.trim())) {
      notes.push(`GAMMA=${value.trim()} is ignored; a Radiance picture is linear`);
    }
  }
  if (kind === "32-bit_rle_xyze") matrix = xyzToSrgb();
  else if (kind !== "32-bit_rle_rgbe") {
    throw new Error(`its FORMAT is '${kind}', not 32-bit_rle_rgbe or 32-bit_rle_xyze`);
  }
  const byColumn = found[2] === "X";
  const sign = { [found[2]]: found[1], [found[5]]: found[4] };
  const size = { [found[2]]: Number(found[3]), [found[5]]: Number(found[6]) };
  return {
    toRadiance: Array.from(matrix, (value, i) => value / applied[i % 3]),
    byColumn, mirrored: sign.X === "-", upsideDown: sign.Y === "+", // Y goes up in Radiance: decreasing is from the top
    width: size.X, height: size.Y, size: at, notes,
  };
}

function numbers(name, value, count, positive = true) {
  const found = value.split(/\s+/).filter(Boolean).slice(0, count).map(Number);
  if (found.length < count || !found.every(x => Number.isFinite(x) && (x > 0 || !positive))) {
    const text = `${name}=${value}`.slice(0, 80);
    throw new Error(`its header says '${text}', not ${count} ${positive ? "positive " : ""}numbers`);
  }
  return found;
}

/** Writes the texel whose four bytes begin at a place of a scanline. */
function texelWriter({ toRadiance: m, width }, data) {
  const powers = Float64Array.from({ length: 256 }, (_, e) => (e ? 2 ** (e - 136) : 0));
  const byChannel = [1, 2, 3, 5, 6, 7].every(i => m[i] === 0);
  const [red, green, blue] = [m[0], m[4], m[8]].map(Math.fround); // products of two float32 are rounded once
  return (line, at, row, column) => {
    const power = powers[line[at + 3]], to = 3 * (width * row + column);
    const r = line[at] * power, g = line[at + 1] * power, b = line[at + 2] * power;
    if (byChannel) {
      data[to] = r * red;
      data[to + 1] = g * green;
      data[to + 2] = b * blue;
    } else {
      for (let i = 0; i < 3; i++) data[to + i] = m[3 * i] * r + m[3 * i + 1] * g + m[3 * i + 2] * b;
    }
  };
}

/** Fills a scanline of texels of four bytes; returns the position after it. */
function readScanline(bytes, at, line, number) {
  const length = line.length / 4;
  const marked = bytes[at] === 2 && bytes[at + 1] === 2 && bytes[at + 2] < 128;
  if (!marked || length < SHORTEST || length > LONGEST) return readByTexel(bytes, at, line);
  const said = (bytes[at + 2] << 8) | bytes[at + 3];
  if (said !== length) throw new Error(`its scanline ${number} is ${said} texels long, not ${length}`);
  return readByComponent(bytes, at + 4, line);
}

/** Run-length codes of all first bytes, all second, all third and all fourth. */
function readByComponent(bytes, at, line) {
  const length = line.length / 4;
  let done = 0;
  const put = value => {
    if (done === line.length) throw new Error("its run lengths do not fit its scanlines");
    line[4 * (done % length) + Math.floor(done / length)] = value;
    done++;
  };
  while (done < line.length) {
    const code = bytes[at], repeated = code > 128, used = repeated ? 2 : 1 + code;
    if (!(at + used <= bytes.length)) throw cutShort();
    for (let i = 0; i < (repeated ? code - 128 : code); i++) put(bytes[repeated ? at + 1 : at + 1 + i]);
    at += used;
  }
  return at;
}

/**
 * Plain texels and Radiance 1's repetitions: mantissas 1, 1, 1 repeat the texel before; the exponent is how often, in
 * ever higher bytes for those that follow each other.
 */
function readByTexel(bytes, at, line) {
  let done = 0, shift = 0;
  while (done < line.length) {
    if (at + 4 > bytes.length) throw cutShort();
    const mark = bytes[at] === 1 && bytes[at + 1] === 1 && bytes[at + 2] === 1;
    if (mark) {
      const times = bytes[at + 3] * 2 ** shift;
      if (done === 0 || 4 * times > line.length - done) throw new Error("its run lengths do not fit its scanlines");
      for (let i = 0; i < times; i++, done += 4) line.copyWithin(done, done - 4, done);
    } else {
      for (let i = 0; i < 4; i++) line[done + i] = bytes[at + i];
      done += 4;
    }
    shift = mark ? shift + 8 : 0;
    at += 4;
  }
  return at;
}
