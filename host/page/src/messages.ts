// What the page and the worker that owns a line say to each other.

import type { SensorInfo } from "./board";
import type { Guide } from "./guide";
import type { Contacts, Depth, Field, Image, Learned, Residual, Wrench } from "./results";
import type { Counters } from "./wire/framing";

export type ToWorker =
  | { kind: "websocket"; url: string; schema: Uint8Array }
  | { kind: "streams"; readable: ReadableStream<Uint8Array>; writable: WritableStream<Uint8Array>; schema: Uint8Array }
  | { kind: "command"; id: number; name: string; value: Record<string, unknown> }
  | { kind: "subscribe"; every: Record<string, number> }
  | { kind: "file"; file: Blob } // a recording in the place of a line
  | { kind: "record"; isOn: boolean }
  | { kind: "flash"; file: Blob }
  | { kind: "answer"; word: "done" | "stop"; asked: number; typed: string } // to a collection that has this page beside it
  | { kind: "choose"; word: string; step: number; fields: Record<string, string> } // in a calibration from this page
  | { kind: "shown" } // the last snapshot is on the screen: the next one may come
  | { kind: "close" };

export interface Hello {
  serial: string;
  firmware: string;
  session: number;
  /** Keys of who alone may change something on it; empty: anybody may. */
  ownersKeys: string[];
  sensors: SensorInfo[];
}

/** The newest of everything that came since the snapshot before. */
export interface SensorNews {
  wrench?: Wrench;
  field?: Field;
  depth?: Depth;
  contacts?: Contacts;
  image?: Image;
  learned?: Learned;
  residual?: Residual;
  flags?: string[]; // of the newest stamp
  isSimulated?: boolean;
  isReplay?: boolean;
  /** Every wrench since then for the charts: capture time, six values, row by row. */
  trace: Float64Array;
}

export interface Status {
  frameRateHz: number;
  uptimeS: number;
  health: string[];
  drops: [string, number][];
  saturations: number;
  temperatures: [string, number][]; // degrees Celsius
  stages: [string, number, number][]; // mean and largest, ms
}

export interface LineHealth {
  counters: Counters;
  nUndecodable: number;
  bytesPerS: number;
  perS: [string, number][]; // messages by type
  notSent: number; // results that a newer one replaced in the server because this page was slow
  notShown: number; // results that a newer one replaced before they were drawn
  delays: number[]; // histogram of how much later than the fastest a WRENCH came, bins of DELAY_BIN_MS
}

export const DELAY_BIN_MS = 2;
export const N_DELAY_BINS = 16; // the last one holds all that is later

export interface Snapshot {
  sensors: [number, SensorNews][];
  status?: Status;
  events: { severity: number; what: string; text: string }[];
  health: LineHealth;
}

/** What a sensor says to a command, or why nothing was heard. */
export interface Answer {
  isOk: boolean;
  /** The command was understood and is not obeyed as things are: a pad that is pressed, a wrong board. */
  isRefused: boolean;
  text: string;
}

export type FromWorker =
  | { kind: "hello"; hello: Hello }
  | { kind: "problem"; text: string }
  | { kind: "line"; isOpen: boolean; port: string; text: string }
  | { kind: "snapshot"; snapshot: Snapshot }
  | { kind: "guide"; guide: Guide }
  | { kind: "flashing"; part: number; text: string; isOver: boolean; isOk: boolean }
  | { kind: "recorded"; blob: Blob; nMessages: number }
  | { kind: "closed" }
  | { kind: "reply"; id: number; answer: Answer };
