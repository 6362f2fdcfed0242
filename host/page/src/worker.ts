// Owns one line: frames, messages and the conversation are dealt with here, the page gets the newest results.

import { sensorInfo } from "./board";
import type { FromWorker, SensorNews, ToWorker } from "./messages";
import { type Counters, Decoder, REPLAY } from "./wire/framing";
import { flash } from "./flashing";
import { readGuide } from "./guide";
import { Model } from "./model";
import { Recording } from "./recording";
import { Replay } from "./replay";
import { CommandError, Session } from "./session";
import { type Decoded, Schema } from "./wire/schema";

const AGAIN_MS = 1000; // between two tries to reach the server
const REPLY_REFUSED = 4; // ReplyCode
const GUIDE_OVER = "The collection has ended, and the page is no longer connected.";

const post = (message: FromWorker, transfer: Transferable[] = []): void => self.postMessage(message, { transfer });

let own: Schema;
let ownSha256: Uint8Array | undefined;
let session: Session | undefined;
let model: Model | undefined;
let every: Record<string, number> = {};
let send: ((data: Uint8Array) => void) | undefined;
let lineCounters: Counters | undefined; // of the server, where one stands between: here only its own losses show
let notSent = 0;
let fileDecoder: Decoder | undefined;
let recording: Recording | undefined;
let lastHello: { schema: Schema; payload: Uint8Array } | undefined;
let tell: ((told: Record<string, unknown>) => void) | undefined; // the server, where one stands between
let release = async (): Promise<void> => undefined; // the streams of a port
let isGuideOver = false;
let isDrawn = true;
let isClosed = false;

function open(write: (data: Uint8Array) => void): void {
  close();
  send = write;
  session = new Session((data) => send?.(data), own, ownSha256, {
    onHello,
    onMessage: (frame, name, message) => {
      const captureUs = message["stamp"]?.["captureUs"] as bigint | undefined;
      recording?.addMessage(name, frame.sequence, frame.payload, captureUs);
      model?.keep(frame, name, message);
      offer();
    },
    onProblem: (text) => post({ kind: "problem", text }),
  });
}

function close(): void {
  session?.stop();
  session = undefined;
  model = undefined;
  send = undefined;
}

function onHello(hello: Decoded, schema: Schema): void {
  lastHello = { schema, payload: schema.encode("Hello", hello) };
  greet(hello, schema);
  subscribe();
}

function greet(hello: Decoded, schema: Schema): void {
  model ??= new Model(schema, () => performance.now());
  const sensors = (hello["sensors"] as Decoded[]).map(sensorInfo);
  const { deviceSerial, firmwareVersion, sessionId } = hello as unknown as Record<string, string | number>;
  post({
    kind: "hello",
    hello: { serial: String(deviceSerial), firmware: String(firmwareVersion), session: Number(sessionId), ownersKeys: ownersKeys(hello), sensors },
  });
}

function ownersKeys(hello: Decoded): string[] {
  if (!hello["needsKey"]) return [];
  const ids = (hello["keyIds"] ?? []) as string[];
  return ids.length ? ids : ["unknown"];
}

function subscribe(): void {
  if (!session || !Object.keys(every).length) return;
  const asked = session;
  // The server may lend the line to a calibration meanwhile, and the page greets again: what was asked before is void.
  asked.subscribe(every).catch((error: unknown) => {
    if (asked === session) post({ kind: "problem", text: textOf(error) });
  });
}

function textOf(error: unknown): string {
  return error instanceof CommandError ? error.message : `The page has a fault: ${String(error)}`;
}

function receive(data: Uint8Array): void {
  model?.countBytes(data.length);
  session?.feed(data);
  recording?.addRaw(data);
  if (recording?.isFull) {
    post({ kind: "problem", text: "The recording is as large as this page can hold: it was ended and is being saved." });
    void endRecording();
  }
}

function beginRecording(): void {
  if (lastHello) recording = new Recording(lastHello.schema, lastHello.payload);
}

async function endRecording(): Promise<void> {
  const ended = recording;
  recording = undefined;
  if (ended) post({ kind: "recorded", blob: await ended.finish(), nMessages: ended.nMessages });
}

/** A file in the place of a line. */
async function play(file: Blob): Promise<void> {
  try {
    const replay = await Replay.open(file);
    const decoder = (fileDecoder = new Decoder());
    model = new Model(replay.schema, () => performance.now());
    greet(replay.hello, replay.schema);
    const feed = (data: Uint8Array): void => {
      model?.countBytes(data.length);
      for (const frame of decoder.feed(data)) {
        const name = replay.schema.typeName(frame.type);
        const message = name && replay.schema.decode(frame.type, frame.payload);
        // Whatever it was when it was recorded, it is not now.
        if (message) model?.keep({ ...frame, flags: frame.flags | REPLAY }, name, message);
      }
      offer();
    };
    const hasEnded = await replay.play(feed, () => isClosed);
    const how = replay.isCut ? "The recording was cut short: it is shown as far as it goes." : "The recording is over.";
    if (hasEnded) post({ kind: "problem", text: `${how} Drop it on the page again to see it once more, or press Live.` });
  } catch (error) {
    post({ kind: "problem", text: `This recording cannot be shown: ${error instanceof Error ? error.message : String(error)}.` });
  }
}

/** The newest results, where the page has drawn the ones before. */
function offer(): void {
  const decoder = session?.decoder ?? fileDecoder;
  if (!isDrawn || !decoder || !model) return;
  if (session) {
    model.nUndecodable += session.nUndecodable;
    session.nUndecodable = 0;
  }
  const snapshot = model.take(lineCounters ?? decoder.counters, notSent);
  if (!snapshot) return;
  isDrawn = false;
  post({ kind: "snapshot", snapshot }, snapshot.sensors.flatMap(([, news]) => buffersOf(news)));
}

function buffersOf(news: SensorNews): Transferable[] {
  const { field, depth, image } = news;
  const arrays = [field?.force, field?.displacement, field?.sigma, field?.slip, depth?.depth, image?.rgba, news.trace];
  return arrays.filter((a) => a !== undefined).map((a) => a.buffer as ArrayBuffer);
}

function openSocket(url: string): void {
  const socket = new WebSocket(url);
  socket.binaryType = "arraybuffer";
  let nSeen = 0;
  tell = (told) => socket.readyState === WebSocket.OPEN && socket.send(JSON.stringify(told));
  socket.onmessage = ({ data }: MessageEvent<ArrayBuffer | string>) => {
    if (typeof data === "string") {
      hearServer(data, socket);
      return;
    }
    receive(new Uint8Array(data));
    socket.send(JSON.stringify({ seen: ++nSeen }));
  };
  socket.onclose = () => {
    close();
    if (isClosed) return;
    const gone = isGuideOver ? GUIDE_OVER : "The viewer's server has gone: start `ruffini view` again.";
    post({ kind: "line", isOpen: false, port: "", text: gone });
    setTimeout(() => openSocket(url), AGAIN_MS);
  };
}

function hearServer(text: string, socket: WebSocket): void {
  let told: Record<string, unknown>;
  try {
    told = Object(JSON.parse(text)) as Record<string, unknown>;
  } catch {
    return; // no JSON: not of this server
  }
  const guide = readGuide(told);
  if (guide) {
    isGuideOver = guide.end !== undefined;
    post({ kind: "guide", guide });
  }
  if (told["kind"] === "health") {
    const { bad_crc, malformed, oversize, incomplete, lost, echo, not_shown } = told as unknown as Counters & { not_shown: number };
    lineCounters = { bad_crc, malformed, oversize, incomplete, lost, echo };
    notSent = not_shown;
    if (session) session.nBrokenBefore = malformed + bad_crc;
  }
  if (told["kind"] !== "line") return;
  const isOpen = told["open"] === true;
  post({ kind: "line", isOpen, port: String(told["port"]), text: String(told["text"]) });
  if (isOpen) open((data) => socket.readyState === WebSocket.OPEN && socket.send(data as Uint8Array<ArrayBuffer>));
  else close();
}

async function openStreams(readable: ReadableStream<Uint8Array>, writable: WritableStream<Uint8Array>): Promise<void> {
  const writer = writable.getWriter();
  open((data) => void writer.write(data).catch(() => undefined));
  const reader = readable.getReader();
  release = async () => {
    await Promise.allSettled([reader.cancel(), writer.close()]);
  };
  try {
    for (;;) {
      const { done, value } = await reader.read();
      if (done) break;
      receive(value);
    }
  } catch {
    // the sensor was unplugged: said below
  }
  close();
  reader.releaseLock();
  await writer.abort().catch(() => undefined);
  if (!isClosed) post({ kind: "line", isOpen: false, port: "", text: "The sensor was unplugged: plug it in again." });
}

self.onmessage = async ({ data }: MessageEvent<ToWorker>) => {
  if (data.kind === "websocket" || data.kind === "streams") {
    own = new Schema(data.schema);
    // Without a secure context there is no SHA-256: then the sensor's schema is asked for.
    ownSha256 = crypto.subtle && new Uint8Array(await crypto.subtle.digest("SHA-256", data.schema as Uint8Array<ArrayBuffer>));
    if (data.kind === "websocket") openSocket(data.url);
    else void openStreams(data.readable, data.writable);
  } else if (data.kind === "file") {
    await play(data.file);
  } else if (data.kind === "flash") {
    await flashFile(data.file);
  } else if (data.kind === "record") {
    if (data.isOn) beginRecording();
    else await endRecording();
  } else if (data.kind === "answer") {
    tell?.({ guide: data.word, asked: data.asked, typed: data.typed });
  } else if (data.kind === "choose") {
    tell?.({ calibrate: data.word, step: data.step, fields: data.fields });
  } else if (data.kind === "shown") {
    isDrawn = true;
    offer();
  } else if (data.kind === "subscribe") {
    every = data.every;
    subscribe();
  } else if (data.kind === "command") {
    await run(data.id, data.name, data.value);
  } else {
    isClosed = true;
    await endRecording();
    close();
    await release();
    post({ kind: "closed" });
    self.close();
  }
};

async function flashFile(file: Blob): Promise<void> {
  const say = (part: number, text: string): void => post({ kind: "flashing", part, text, isOver: false, isOk: true });
  try {
    if (!session) throw new CommandError("No sensor is connected.");
    await flash(session, new Uint8Array(await file.arrayBuffer()), say);
    post({ kind: "flashing", part: 1, text: "It is in force. `ruffini cal undo` puts back what was before.", isOver: true, isOk: true });
  } catch (error) {
    post({ kind: "flashing", part: 0, text: textOf(error), isOver: true, isOk: false });
  }
}

async function run(id: number, name: string, value: Record<string, unknown>): Promise<void> {
  try {
    if (!session) throw new CommandError("No sensor is connected.");
    const reply = await session.command(name, value);
    post({ kind: "reply", id, answer: { isOk: true, isRefused: false, text: String(reply["text"]) } });
  } catch (error) {
    const isRefused = error instanceof CommandError && error.code === REPLY_REFUSED;
    post({ kind: "reply", id, answer: { isOk: false, isRefused, text: textOf(error) } });
  }
}
