// CRC-32C (Castagnoli), reflected, initial value and final XOR 0xFFFFFFFF.

const TABLE = new Uint32Array(256);
for (let i = 0; i < 256; i++) {
  let value = i;
  for (let bit = 0; bit < 8; bit++) value = (value >>> 1) ^ (value & 1 ? 0x82f63b78 : 0);
  TABLE[i] = value;
}

/** Of the ASCII bytes "123456789" it is 0xE3069283. */
export function crc32c(data: Uint8Array): number {
  let value = 0xffffffff;
  for (let i = 0; i < data.length; i++) value = (value >>> 8) ^ TABLE[(value ^ data[i]!) & 0xff]!;
  return (value ^ 0xffffffff) >>> 0;
}
