// Straight to a sensor by WebSerial, in browsers that have it; no server of ours is needed.

import type { Line } from "./line";

const BUFFER_BYTES = 1 << 20; // the browser's own 255 bytes lose most of a field
const BAUD = 115_200; // means nothing on USB, and must be said
const RELEASE_TRIES = 100;
const RELEASE_MS = 20;

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

/** A port that the person has chosen; opens again by itself when the sensor is plugged in again, until `close`. */
export class SerialSource {
  private line: Line | undefined;
  private readonly over = new AbortController();

  constructor(
    readonly port: SerialPortLike,
    private readonly schema: Uint8Array,
    serial: SerialLike,
    private readonly onProblem: (text: string) => void,
  ) {
    const again = (event: Event): void => {
      if (event.target === port || (event as Event & { port?: unknown }).port === port) void this.reopen();
    };
    serial.addEventListener("connect", again, { signal: this.over.signal });
  }

  /** What is wrong where it cannot be opened; empty: it is open. */
  async open(): Promise<string> {
    try {
      await this.port.open({ baudRate: BAUD, bufferSize: BUFFER_BYTES });
    } catch (error) {
      return `The port cannot be opened (${String(error)}): is another program using it, a viewer perhaps?`;
    }
    return this.port.readable && this.port.writable ? "" : "The port gives nothing to read: plug the sensor in again.";
  }

  /** Hand the open port over to a line. */
  lead(line: Line): void {
    this.line = line;
    const { readable, writable } = this.port;
    if (readable && writable) line.tell({ kind: "streams", readable, writable, schema: this.schema }, [readable, writable]);
  }

  private async reopen(): Promise<void> {
    await this.release(); // what is left of the time before it was unplugged
    const problem = await this.open();
    if (problem) this.onProblem(problem);
    else if (this.line) this.lead(this.line);
  }

  /** Give the port back; after the line was closed. */
  async close(): Promise<void> {
    this.over.abort();
    await this.release();
  }

  /** The worker lets go of the streams; until that has come through, a port cannot be closed. */
  private async release(): Promise<void> {
    for (let i = 0; i < RELEASE_TRIES; i++) {
      try {
        return await this.port.close();
      } catch (error) {
        if ((error as Error).name === "InvalidStateError") return; // it is closed
        await new Promise((resolve) => setTimeout(resolve, RELEASE_MS));
      }
    }
  }
}
