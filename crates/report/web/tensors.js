/**
 * Reads a safetensors file: a model, or data from the server. Returns `note`, the JSON under "pwrfgs" in the header, and
 * `get(name)`, `shape(name)`, `has(name)`, `names()`. Numbers of 16 bits, and of 8 bits with scales per row, are converted
 * to 32 bits.
 */
export function readTensors(file) {
  const bytes = file instanceof Uint8Array ? file : new Uint8Array(file);
  const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
  const length = bytes.length < 8 ? Infinity : Number(view.getBigUint64(0, true));
  if (length > bytes.length - 8) throw new Error("incomplete safetensors file");
  const header = JSON.parse(new TextDecoder().decode(bytes.subarray(8, 8 + length)));
  const note = JSON.parse(header.__metadata__?.pwrfgs ?? "null");
  delete header.__metadata__;
  const data = bytes.subarray(8 + length);
  const get = (name) => {
    const values = tensorOf(header[name], data, name);
    const scales = header[`${name}.scales`] && tensorOf(header[`${name}.scales`], data, name);
    const columns = scales && values.length / scales.length;
    return scales ? Float32Array.from(values, (value, i) => value * scales[Math.floor(i / columns)]) : values;
  };
  return { note, get, shape: (name) => header[name].shape, has: (name) => name in header, names: () => Object.keys(header) };
}

const TENSOR_TYPES = { F32: Float32Array, F64: Float64Array, U8: Uint8Array, U32: Uint32Array, I8: Int8Array, F16: Uint16Array };

function tensorOf(entry, data, name) {
  if (!entry) throw new Error(`no tensor ${name}`);
  const type = TENSOR_TYPES[entry.dtype];
  const [from, to] = entry.data_offsets;
  if (!type || to > data.length) throw new Error(`tensor ${name}: damaged or of an unsupported type`);
  const own = data.slice(from, to); // a copy is aligned for every type
  const values = new type(own.buffer, own.byteOffset, own.byteLength / type.BYTES_PER_ELEMENT);
  return entry.dtype === "F16" ? Float32Array.from(values, widenHalf) : values;
}

/** Converts a 16-bit float. */
function widenHalf(bits) {
  const [sign, exponent, fraction] = [bits & 0x8000 ? -1 : 1, (bits >> 10) & 31, bits & 1023];
  if (exponent === 0) return sign * fraction * 2 ** -24;
  return exponent === 31 ? (fraction ? NaN : sign * Infinity) : sign * (1 + fraction / 1024) * 2 ** (exponent - 15);
}
