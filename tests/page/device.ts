// The other end of a conversation, for tests.

import { crc32c } from "../../host/page/src/wire/crc32c";
import { cobsEncode, Decoder, type Frame } from "../../host/page/src/wire/framing";
import { Schema } from "../../host/page/src/wire/schema";
import { ownSchema } from "./golden";

export const SCHEMA = new Schema(ownSchema());

const MAX_PAYLOAD = 4048;

/** A device's message, in as many frames as it needs. */
export function said(name: string, payload: Uint8Array, sequence = 0, flags = 2, sensor = 0): Uint8Array {
  const nFragments = Math.max(Math.ceil(payload.length / MAX_PAYLOAD), 1);
  const frames = Array.from({ length: nFragments }, (_, i) => {
    const part = payload.subarray(i * MAX_PAYLOAD, (i + 1) * MAX_PAYLOAD);
    const body = new Uint8Array(12 + part.length + 4);
    const view = new DataView(body.buffer);
    body.set([1, flags, SCHEMA.typeNumber(name)!, sensor]);
    view.setUint32(4, sequence, true);
    body.set([i, nFragments], 8);
    view.setUint16(10, part.length, true);
    body.set(part, 12);
    view.setUint32(body.length - 4, crc32c(body.subarray(0, body.length - 4)), true);
    return [...cobsEncode(body), 0];
  });
  return Uint8Array.from(frames.flat());
}

export function saidAs(name: string, message: string, fields: Record<string, unknown>, sequence = 0): Uint8Array {
  return said(name, SCHEMA.encode(message, fields), sequence);
}

/** What a host has sent. */
export class Heard {
  private readonly decoder = new Decoder(true);
  readonly frames: Frame[] = [];

  readonly take = (data: Uint8Array): void => {
    this.frames.push(...this.decoder.feed(data));
  };

  names(): (string | undefined)[] {
    return this.frames.map((f) => SCHEMA.typeName(f.type));
  }

  commands(): Record<string, any>[] {
    return this.frames.filter((f) => SCHEMA.typeName(f.type) === "COMMAND").map((f) => SCHEMA.decode(f.type, f.payload)!);
  }
}

/** Node values as proto/README.md packs them, as slowly and as plainly as can be. */
export function packed(values: number[]): Uint8Array {
  const out: number[] = [];
  for (let start = 0; start < values.length; start += 32) {
    const block = Array.from({ length: 32 }, (_, i) => values[start + i] ?? 0).map((v) => (v >= 0 ? 2 * v : -2 * v - 1));
    const width = Math.max(...block).toString(2).length * Number(block.some((v) => v > 0));
    const bits = block.flatMap((v) => Array.from({ length: width }, (_, i) => Math.floor(v / 2 ** i) % 2));
    out.push(width);
    for (let k = 0; k < bits.length; k += 8) out.push(bits.slice(k, k + 8).reduce((byte, bit, i) => byte + bit * 2 ** i, 0));
  }
  return Uint8Array.from(out);
}

export function dense(nX: number, nY: number, nComponents: number, values: number[]): Record<string, unknown> {
  return { codec: 0, nX, nY, nComponents, data: packed(values) };
}
