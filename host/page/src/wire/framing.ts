// Frames of proto/README.md: header, payload, CRC-32C, COBS, 0x00; messages put together from fragments.
// Nothing here throws on what the line brings, and no more is held than one frame and one unfinished message.

import { crc32c } from "./crc32c";

export const PROTOCOL_VERSION = 1;
export const MAX_FRAME_BYTES = 4096;
export const MAX_PAYLOAD_BYTES = 4048;
export const FROM_HOST = 1;
export const SIMULATED = 2;
export const REPLAY = 4;
export const DEVICE_SENSOR = 255;
const KNOWN_FLAGS = 7;
const HEADER_BYTES = 12;
const RESTART_GAP = 2 ** 31; // a sequence that goes back: the device was started again, nothing was lost

/** One whole message. */
export interface Frame {
  type: number;
  sensor: number;
  sequence: number;
  flags: number;
  payload: Uint8Array;
}

/** Why received bytes were thrown away, and how many messages the device sent that never came. */
export interface Counters {
  bad_crc: number;
  malformed: number;
  oversize: number;
  incomplete: number;
  lost: number;
  echo: number;
}

export function cobsEncode(data: Uint8Array): Uint8Array {
  const out = new Uint8Array(data.length + Math.floor(data.length / 254) + 1);
  let code = 0;
  let at = 1;
  for (let i = 0; i < data.length; i++) {
    if (data[i] !== 0) out[at++] = data[i]!;
    if (data[i] === 0 || at - code === 255) {
      out[code] = at - code;
      code = at++;
    }
  }
  out[code] = at - code;
  return out.subarray(0, at);
}

/** The inverse, into `out`; the number of bytes, or -1 where `data` is no COBS. */
export function cobsDecode(data: Uint8Array, out: Uint8Array): number {
  let n = 0;
  for (let at = 0; at < data.length; ) {
    const code = data[at]!;
    const end = at + code;
    if (code === 0 || end > data.length) return -1;
    for (let i = at + 1; i < end; i++) {
      if (data[i] === 0) return -1;
      out[n++] = data[i]!;
    }
    at = end;
    if (code !== 0xff && at < data.length) out[n++] = 0;
  }
  return n;
}

/** One frame of a host's message, ready to be written. Throws RangeError above 4,048 bytes: the device takes no more. */
export function encodeCommandFrame(type: number, payload: Uint8Array, sequence: number): Uint8Array {
  if (payload.length > MAX_PAYLOAD_BYTES) throw new RangeError(`a message of ${payload.length} bytes is more than one frame`);
  const body = new Uint8Array(HEADER_BYTES + payload.length + 4);
  const view = new DataView(body.buffer);
  body.set([PROTOCOL_VERSION, FROM_HOST, type, DEVICE_SENSOR]);
  view.setUint32(4, sequence >>> 0, true);
  body.set([0, 1], 8);
  view.setUint16(10, payload.length, true);
  body.set(payload, HEADER_BYTES);
  view.setUint32(body.length - 4, crc32c(body.subarray(0, body.length - 4)), true);
  const encoded = cobsEncode(body);
  const out = new Uint8Array(encoded.length + 1);
  out.set(encoded);
  return out;
}

interface Open {
  type: number;
  sensor: number;
  sequence: number;
  flags: number;
  nFragments: number;
  parts: Uint8Array[];
}

/** Byte stream -> messages of one direction. */
export class Decoder {
  readonly counters: Counters = { bad_crc: 0, malformed: 0, oversize: 0, incomplete: 0, lost: 0, echo: 0 };
  private readonly buffer = new Uint8Array(MAX_FRAME_BYTES);
  private readonly raw = new Uint8Array(MAX_FRAME_BYTES);
  private n = 0;
  private isOversize = false;
  private open: Open | undefined;
  private readonly last = new Map<number, number>();

  constructor(private readonly fromHost = false) {}

  /** The messages that `data` completes; their payloads are copies. */
  feed(data: Uint8Array): Frame[] {
    const out: Frame[] = [];
    for (let start = 0; ; ) {
      const end = data.indexOf(0, start);
      this.keep(data.subarray(start, end < 0 ? data.length : end));
      if (end < 0) return out;
      start = end + 1;
      const n = this.n;
      const wasOversize = this.isOversize;
      this.n = 0;
      this.isOversize = false;
      if (wasOversize || n === 0) continue;
      const frame = this.finish(this.buffer.subarray(0, n));
      if (frame) out.push(frame);
    }
  }

  private keep(chunk: Uint8Array): void {
    if (this.isOversize) return;
    if (this.n + chunk.length > MAX_FRAME_BYTES - 1) {
      this.isOversize = true;
      this.n = 0;
      this.counters.oversize++;
      return;
    }
    this.buffer.set(chunk, this.n);
    this.n += chunk.length;
  }

  private finish(encoded: Uint8Array): Frame | undefined {
    const n = cobsDecode(encoded, this.raw);
    if (n < HEADER_BYTES + 4) {
      this.counters.malformed++;
      return undefined;
    }
    const view = new DataView(this.raw.buffer, 0, n);
    if (crc32c(this.raw.subarray(0, n - 4)) !== view.getUint32(n - 4, true)) {
      this.counters.bad_crc++;
      return undefined;
    }
    const [version, flags, type, sensor] = this.raw as unknown as [number, number, number, number];
    const [fragment, nFragments] = [this.raw[8]!, this.raw[9]!];
    const size = view.getUint16(10, true);
    const isWhole = size === n - HEADER_BYTES - 4 && size <= MAX_PAYLOAD_BYTES;
    if (version !== PROTOCOL_VERSION || flags & ~KNOWN_FLAGS || !isWhole || fragment >= nFragments) {
      this.counters.malformed++;
      return undefined;
    }
    if (Boolean(flags & FROM_HOST) !== this.fromHost) {
      this.counters.echo++;
      return undefined;
    }
    const payload = this.raw.slice(HEADER_BYTES, HEADER_BYTES + size);
    return this.assemble({ type, sensor, sequence: view.getUint32(4, true), flags, nFragments, parts: [payload] }, fragment);
  }

  private assemble(head: Open, fragment: number): Frame | undefined {
    const { type, sensor, sequence, flags, nFragments } = head;
    if (fragment === 0) {
      if (this.open) this.counters.incomplete++;
      this.open = head;
    } else if (this.open && isSame(this.open, head) && fragment === this.open.parts.length) {
      this.open.parts.push(head.parts[0]!);
    } else {
      if (this.open) this.counters.incomplete++;
      this.open = undefined;
      return undefined;
    }
    const parts = this.open.parts;
    if (parts.length < nFragments) return undefined;
    this.open = undefined;
    const before = this.last.get(sensor);
    const missing = before === undefined ? 0 : (sequence - before - 1) >>> 0;
    if (missing < RESTART_GAP) this.counters.lost += missing;
    this.last.set(sensor, sequence);
    return { type, sensor, sequence, flags, payload: parts.length === 1 ? parts[0]! : joined(parts) };
  }
}

function isSame(a: Open, b: Open): boolean {
  return (
    a.type === b.type && a.sensor === b.sensor && a.sequence === b.sequence && a.flags === b.flags && a.nFragments === b.nFragments
  );
}

function joined(parts: Uint8Array[]): Uint8Array {
  const out = new Uint8Array(parts.reduce((n, part) => n + part.length, 0));
  let at = 0;
  for (const part of parts) {
    out.set(part, at);
    at += part.length;
  }
  return out;
}
