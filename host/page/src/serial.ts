// Straight to a sensor by WebSerial: Chrome and Edge on a computer; no server of ours is needed.

import type { Line } from "./line";

const BUFFER_BYTES = 1 << 20; // the browser's own 255 bytes lose most of a field
const BAUD = 115_200; // means nothing on USB, and must be said

/** As far as we use it; TypeScript's own list of the browser's objects has none. */
export interface SerialPortLike extends EventTarget {
  open(options: { baudRate: number; bufferSize: number }): Promise<void>;
  close(): Promise<void>;
  readonly readable: ReadableStream<Uint8Array> | null;
  readonly writable: WritableStream<Uint8Array> | null;
}

export interface SerialLike extends EventTarget {
  requestPort(): Promise<SerialPortLike>;
}

export function serialOf(navigator: Navigator): SerialLike | undefined {
  return (navigator as Navigator & { serial?: SerialLike }).serial;
}

export const NO_SERIAL =
  "This browser cannot open serial ports itself (WebSerial): take Chrome, Edge or a new Firefox, or start `ruffini view` on this computer, which works with any browser.";

/** A port that the person has chosen; opens again by itself when the sensor is plugged in again. */
export class SerialSource {
  constructor(
    private readonly port: SerialPortLike,
    private readonly line: Line,
    private readonly schema: Uint8Array,
    serial: SerialLike,
    private readonly onProblem: (text: string) => void,
  ) {
    serial.addEventListener("connect", (event) => {
      if (event.target === port || (event as Event & { port?: unknown }).port === port) void this.open();
    });
  }

  /** Says what is wrong where it cannot be opened. */
  async open(): Promise<void> {
    await this.port.close().catch(() => undefined); // what is left of the time before it was unplugged
    try {
      await this.port.open({ baudRate: BAUD, bufferSize: BUFFER_BYTES });
    } catch (error) {
      this.onProblem(`The port cannot be opened (${String(error)}): is another program using it, a viewer perhaps?`);
      return;
    }
    const { readable, writable } = this.port;
    if (!readable || !writable) return this.onProblem("The port gives nothing to read: plug the sensor in again.");
    this.line.tell({ kind: "streams", readable, writable, schema: this.schema }, [readable, writable]);
  }
}
