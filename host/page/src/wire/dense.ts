// Node values of proto/README.md: zigzag, blocks of 32, bit packing; sparse with a bitmap of active nodes.

const BLOCK = 32;
const PACKED = 0;
const SPARSE = 1;
const MAX_VALUES = 1 << 22; // more than any sensor has; nothing from the wire reserves beyond it

/** What a Dense message brings. */
export interface DenseMessage {
  codec: number;
  nX: number;
  nY: number;
  nComponents: number;
  data: Uint8Array;
}

/** Bytes that are not what their sizes say; the text says how. */
export class BadData extends Error {}

/** `nValues` values into `out` from data[at ...]; returns where it ended. */
function unpack(data: Uint8Array, at: number, nValues: number, out: Int32Array): number {
  for (let first = 0; first < nValues; first += BLOCK) {
    const width = data[at];
    if (width === undefined) throw new BadData("dense data is truncated");
    if (width > 32 || at + 1 + 4 * width > data.length) throw new BadData(`a block of width ${width} does not fit`);
    at++;
    const n = Math.min(BLOCK, nValues - first);
    const mask = width === 32 ? 0xffffffff : 2 ** width - 1;
    for (let i = 0, bit = 0; i < n && width > 0; i++, bit += width) {
      const byte = at + (bit >>> 3);
      const shift = bit & 7;
      // Up to 39 bits: four bytes, and a fifth where the value reaches into it.
      const low = data[byte]! | (byteAt(data, byte + 1) << 8) | (byteAt(data, byte + 2) << 16) | (byteAt(data, byte + 3) << 24);
      let value = low >>> shift;
      if (shift + width > 32) value |= byteAt(data, byte + 4) << (32 - shift);
      value = (value & mask) >>> 0;
      out[first + i] = (value >>> 1) ^ -(value & 1);
    }
    at += 4 * width;
  }
  return at;
}

/** Beyond the end only where the mask takes it away again. */
function byteAt(data: Uint8Array, at: number): number {
  return at < data.length ? data[at]! : 0;
}

/** Values node by node, components interleaved. Throws BadData where the data is not exactly what the sizes say. */
export function decodeDense(message: DenseMessage): Int32Array {
  const { codec, nX, nY, nComponents, data } = message;
  const nNodes = nX * nY;
  const nValues = nNodes * nComponents;
  if (!(nValues > 0 && nValues <= MAX_VALUES)) throw new BadData(`${nX} x ${nY} x ${nComponents} values make no sense`);
  if (codec === PACKED) {
    // 32 values take a byte at the least: what is shorter reserves nothing.
    if (data.length * BLOCK < nValues) throw new BadData("dense data is truncated");
    const out = new Int32Array(nValues);
    if (unpack(data, 0, nValues, out) !== data.length) throw new BadData("dense data has bytes too many");
    return out;
  }
  if (codec === SPARSE) return decodeSparse(nNodes, nComponents, data);
  throw new BadData(`dense data in unknown codec ${codec}: this page is older than the sensor`);
}

function decodeSparse(nNodes: number, nComponents: number, data: Uint8Array): Int32Array {
  const nBitmap = Math.ceil(nNodes / 8);
  if (data.length < nBitmap) throw new BadData("dense data is shorter than its bitmap");
  const active: number[] = [];
  for (let node = 0; node < 8 * nBitmap; node++) {
    if (!((data[node >>> 3]! >>> (node & 7)) & 1)) continue;
    if (node >= nNodes) throw new BadData("dense data marks nodes that do not exist");
    active.push(node);
  }
  const packed = new Int32Array(active.length * nComponents);
  if (unpack(data, nBitmap, packed.length, packed) !== data.length) throw new BadData("dense data has bytes too many");
  const out = new Int32Array(nNodes * nComponents);
  active.forEach((node, i) => out.set(packed.subarray(i * nComponents, (i + 1) * nComponents), node * nComponents));
  return out;
}
