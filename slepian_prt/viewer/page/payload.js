/**
 * The payload of a page: JSON, in which `{"buffer": …}` stands for arrays that follow it.
 * `slepian_prt/viewer/buffers.py` says how they are coded.
 */

const ARRAYS = {
  int16: Int16Array,
  int32: Int32Array,
  uint8: Uint8Array,
  uint16: Uint16Array,
  uint32: Uint32Array,
  float16: Uint16Array, // by their bits
  float32: Float32Array,
  float64: Float64Array,
};

/**
 * Read a payload.
 *
 * @param {string} base64 of a gzip stream of: the length of the JSON in 4 bytes, the JSON, padding to 8 bytes, buffers
 * @returns {Promise<object>} the JSON with typed arrays in the place of its buffers: rows one after the other
 */
export async function readPayload(base64) {
  const bytes = await inflate(base64);
  const length = new DataView(bytes.buffer).getUint32(0, true);
  const content = JSON.parse(new TextDecoder().decode(bytes.subarray(4, 4 + length)));
  return withArrays(content, bytes.subarray((4 + length + 7) & ~7));
}

/**
 * @param {string} base64 of a gzip stream
 * @returns {Promise<Uint8Array>}
 */
async function inflate(base64) {
  const packed = Uint8Array.from(atob(base64.trim()), (letter) => letter.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

/** The same JSON with arrays in the place of buffers. */
function withArrays(value, bytes) {
  if (Array.isArray(value)) return value.map((one) => withArrays(one, bytes));
  if (value === null || typeof value !== "object") return value;
  if (value.buffer !== undefined) return decodeBuffer(value.buffer, bytes);
  return Object.fromEntries(Object.entries(value).map(([name, one]) => [name, withArrays(one, bytes)]));
}

/**
 * @param {{type: string, rows: number, columns: number, coding: string, begin: number, size: number,
 *   scale?: number|number[], offset?: number|number[]}} entry
 * @param {Uint8Array} bytes all buffers
 * @returns {TypedArray} rows * columns numbers
 */
export function decodeBuffer(entry, bytes) {
  const numbers = CODINGS[entry.coding](bytes.subarray(entry.begin, entry.begin + entry.size), entry);
  const values = entry.type === "float16" ? fromHalf(numbers) : numbers;
  return entry.scale === undefined ? values : scaled(values, entry);
}

const CODINGS = {
  plain(bytes, { type }) {
    return new ARRAYS[type](bytes.slice().buffer);
  },
  planes: fromPlanes,
  folded(bytes, entry) {
    const folded = fromPlanes(bytes, { ...entry, type: `u${entry.type}` });
    const numbers = new ARRAYS[entry.type](folded.length);
    for (let i = 0; i < folded.length; i++) numbers[i] = unfolded(folded[i]);
    return numbers;
  },
  steps(bytes, entry) {
    const numbers = fromPlanes(bytes, entry);
    const { columns } = entry;
    // Typed arrays wrap as the differences do.
    for (let i = 0; i < numbers.length; i++) {
      numbers[i] = unfolded(numbers[i]) + (i < columns ? 0 : numbers[i - columns]);
    }
    return numbers;
  },
  clusters(bytes, entry) {
    const numbers = fromPlanes(bytes, entry);
    const { rows, columns } = entry;
    const last = new Int32Array(256).fill(-1); // where the last row of each cluster begins
    for (let row = 0; row < rows; row++) {
      const begin = row * columns;
      const cluster = numbers[begin + columns - 1];
      const before = last[cluster];
      for (let column = 0; column < columns - 1; column++) {
        numbers[begin + column] += before < 0 ? 128 : numbers[before + column];
      }
      last[cluster] = begin;
    }
    return numbers;
  },
  corners(bytes, entry) {
    const numbers = fromPlanes(bytes, entry);
    let next = 0;
    for (let i = 0; i < numbers.length; i++) {
      numbers[i] = next - numbers[i];
      if (numbers[i] === next) next += 1;
    }
    return numbers;
  },
};

/** 0, -1, 1, -2, … from 0, 1, 2, 3, … */
function unfolded(number) {
  return (number >>> 1) ^ -(number & 1);
}

/** Numbers from bytes (columns, bytes of a number, rows). */
function fromPlanes(bytes, { type, rows, columns }) {
  const numbers = new ARRAYS[type](rows * columns);
  const octets = new Uint8Array(numbers.buffer); // as little-endian as all machines with WebGL2 are
  const width = numbers.BYTES_PER_ELEMENT;
  const stride = columns * width;
  for (let plane = 0; plane < stride; plane++) {
    const begin = plane * rows;
    for (let row = 0, to = plane; row < rows; row++, to += stride) octets[to] = bytes[begin + row];
  }
  return numbers;
}

/** Float32Array of the bits of 16-bit floats. */
function fromHalf(bits) {
  const values = new Float32Array(bits.length);
  for (let i = 0; i < bits.length; i++) {
    const exponent = (bits[i] >> 10) & 31;
    const fraction = bits[i] & 1023;
    let size = Infinity; // writers refuse NaN
    if (exponent === 0) size = fraction * 2 ** -24;
    else if (exponent < 31) size = (1 + fraction / 1024) * POWERS[exponent];
    values[i] = bits[i] & 32768 ? -size : size;
  }
  return values;
}

const POWERS = Float64Array.from({ length: 31 }, (_, exponent) => 2 ** (exponent - 15));

/** Float32Array of numbers times a scale, plus an offset, each one number or one for each column. */
function scaled(numbers, { columns, scale, offset = 0 }) {
  const scales = Array.isArray(scale) ? scale : new Array(columns).fill(scale);
  const offsets = Array.isArray(offset) ? offset : new Array(columns).fill(offset);
  const values = new Float32Array(numbers.length);
  for (let i = 0, column = 0; i < numbers.length; i++) {
    values[i] = numbers[i] * scales[column] + offsets[column];
    column = column + 1 === columns ? 0 : column + 1;
  }
  return values;
}
