// Reads the arrays of an .npz file that numpy.savez wrote: a zip of uncompressed .npy files.

const TYPES = { "<f4": Float32Array, "<f8": Float64Array };

// Return { name: { data, dims } } from an ArrayBuffer.
export function readNpz(buffer) {
  const view = new DataView(buffer);
  let end = buffer.byteLength - 22;
  while (end >= 0 && view.getUint32(end, true) !== 0x06054b50) end -= 1;
  if (end < 0) throw new Error("not a zip archive");
  const count = view.getUint16(end + 10, true);
  const arrays = {};
  let at = view.getUint32(end + 16, true);
  for (let i = 0; i < count; i += 1) {
    const method = view.getUint16(at + 10, true);
    const nameLength = view.getUint16(at + 28, true);
    const skip = view.getUint16(at + 30, true) + view.getUint16(at + 32, true);
    const local = view.getUint32(at + 42, true);
    const name = text(buffer, at + 46, nameLength);
    if (method !== 0) throw new Error(`${name} is compressed`);
    const start = local + 30 + view.getUint16(local + 26, true) + view.getUint16(local + 28, true);
    arrays[name.replace(/\.npy$/, "")] = readNpy(buffer, start);
    at += 46 + nameLength + skip;
  }
  return arrays;
}

function readNpy(buffer, start) {
  const view = new DataView(buffer, start);
  const wide = view.getUint8(6) > 1;
  const length = wide ? view.getUint32(8, true) : view.getUint16(8, true);
  const first = wide ? 12 : 10;
  const header = text(buffer, start + first, length);
  const type = TYPES[/'descr': '([^']+)'/.exec(header)[1]];
  if (!type || /'fortran_order': True/.test(header)) throw new Error(`cannot read ${header}`);
  const dims = /'shape': \(([^)]*)\)/.exec(header)[1].split(",").map((d) => d.trim());
  const shape = dims.filter((d) => d !== "").map(Number);
  const size = shape.reduce((product, d) => product * d, 1) * type.BYTES_PER_ELEMENT;
  const from = start + first + length;
  return { data: new type(buffer.slice(from, from + size)), dims: shape };
}

function text(buffer, start, length) {
  return new TextDecoder("latin1").decode(new Uint8Array(buffer, start, length));
}
