// A recording in the place of a sensor: the bytes as they came, at the pace at which they came.

import { type IReadable, McapConstants, McapIndexedReader, McapStreamReader } from "@mcap/core";
import { decompress as unzstd } from "fzstd";
import { RAW_TOPIC } from "./recording";
import { type Decoded, Schema } from "./wire/schema";

const HELLO_TOPIC = "/ruffini/hello";
const MAX_CHUNK_BYTES = 256 << 20; // no recorder of ours writes larger ones
const PIECE_BYTES = 1 << 20;
const MCAP_MAGIC = McapConstants.MCAP_MAGIC;
const NO_SENSOR = "it does not say what sensor it is of: record with `ruffini record` of this version, or from this page";
const MAX_PAUSE_MS = 2000; // a time without line is not waited for as long as it was

/** A file that cannot be shown; the text says why. */
export class BadRecording extends Error {}

class BlobReader implements IReadable {
  constructor(private readonly blob: Blob) {}

  size(): Promise<bigint> {
    return Promise.resolve(BigInt(this.blob.size));
  }

  async read(offset: bigint, size: bigint): Promise<Uint8Array> {
    const [from, to] = [Number(offset), Number(offset + size)];
    if (to > this.blob.size) throw new BadRecording("the file ends before it is complete");
    return new Uint8Array(await this.blob.slice(from, to).arrayBuffer());
  }
}

interface RawMessage {
  logTime: bigint;
  data: Uint8Array;
}

/** What is read of a file: who it is of, and the bytes as they came. */
interface Source {
  schema: Schema;
  hello: Decoded;
  raw(): AsyncIterable<RawMessage>;
}

export class Replay {
  private constructor(
    private readonly source: Source,
    /** The end of the file is missing: it is shown as far as it goes. */
    readonly isCut: boolean,
  ) {}

  get schema(): Schema {
    return this.source.schema;
  }

  get hello(): Decoded {
    return this.source.hello;
  }

  /** Rejects with BadRecording. */
  static async open(file: Blob): Promise<Replay> {
    if (!(await isMagic(file.slice(0, MCAP_MAGIC.length)))) throw new BadRecording("it is no MCAP file");
    const isCut = !(await isMagic(file.slice(-MCAP_MAGIC.length))) || file.size < 2 * MCAP_MAGIC.length;
    try {
      return new Replay(isCut ? await cutSource(file) : await indexedSource(file), isCut);
    } catch (error) {
      if (error instanceof BadRecording) throw error;
      throw new BadRecording(`it is damaged (${String(error).slice(0, 120)})`);
    }
  }

  /** Hands over the bytes at their pace; true when the end was reached, false when `isOver` said so. */
  async play(feed: (data: Uint8Array) => void, isOver: () => boolean): Promise<boolean> {
    let before = 0n; // also the stamp of what came before the first result
    for await (const message of this.source.raw()) {
      const waitMs = !before ? 0 : Number(message.logTime - before) / 1e6;
      before = message.logTime;
      if (waitMs > 0) await new Promise((resolve) => setTimeout(resolve, Math.min(waitMs, MAX_PAUSE_MS)));
      if (isOver()) return false;
      feed(message.data);
    }
    return true;
  }
}

async function isMagic(part: Blob): Promise<boolean> {
  const bytes = new Uint8Array(await part.arrayBuffer());
  return bytes.length === MCAP_MAGIC.length && MCAP_MAGIC.every((byte, i) => bytes[i] === byte);
}

function zstd(buffer: Uint8Array, size: bigint): Uint8Array {
  if (size > MAX_CHUNK_BYTES) throw new BadRecording("a chunk of it is larger than any of ours");
  return unzstd(buffer, new Uint8Array(Number(size)));
}

function helloOf(schemaBytes: Uint8Array, payload: Uint8Array): [Schema, Decoded] {
  const schema = new Schema(schemaBytes);
  const hello = schema.decode(schema.typeNumber("HELLO")!, payload);
  if (!hello) throw new BadRecording("its HELLO cannot be read");
  return [schema, hello];
}

/** A whole file, by its index. */
async function indexedSource(file: Blob): Promise<Source> {
  const reader = await McapIndexedReader.Initialize({ readable: new BlobReader(file), decompressHandlers: { zstd } });
  const channels = [...reader.channelsById.values()];
  const channel = channels.find((c) => c.topic === HELLO_TOPIC);
  if (!channel || !channels.some((c) => c.topic === RAW_TOPIC)) throw new BadRecording(NO_SENSOR);
  for await (const message of reader.readMessages({ topics: [HELLO_TOPIC] })) {
    const [schema, hello] = helloOf(reader.schemasById.get(channel.schemaId)!.data, message.data);
    return { schema, hello, raw: () => reader.readMessages({ topics: [RAW_TOPIC] }) };
  }
  throw new BadRecording("its HELLO cannot be read");
}

/** A file without its end, which has the index: from the beginning, each chunk that is whole. */
async function cutSource(file: Blob): Promise<Source> {
  for await (const { topic, schema, message } of messagesOf(file)) {
    if (topic !== HELLO_TOPIC || !schema) continue;
    const [own, hello] = helloOf(schema, message.data);
    return { schema: own, hello, raw: () => rawOf(file) };
  }
  throw new BadRecording("it was cut short before anything that can be shown");
}

async function* rawOf(file: Blob): AsyncGenerator<RawMessage> {
  for await (const { topic, message } of messagesOf(file)) if (topic === RAW_TOPIC) yield message;
}

async function* messagesOf(file: Blob): AsyncGenerator<{ topic: string; schema: Uint8Array | undefined; message: RawMessage }> {
  const reader = new McapStreamReader({ decompressHandlers: { zstd } });
  const schemas = new Map<number, Uint8Array>();
  const channels = new Map<number, { topic: string; schemaId: number }>();
  for (let at = 0; at < file.size; at += PIECE_BYTES) {
    reader.append(new Uint8Array(await file.slice(at, at + PIECE_BYTES).arrayBuffer()));
    for (let record; (record = reader.nextRecord()); ) {
      if (record.type === "Schema") schemas.set(record.id, record.data);
      else if (record.type === "Channel") channels.set(record.id, record);
      else if (record.type === "Message") {
        const channel = channels.get(record.channelId);
        if (channel) yield { topic: channel.topic, schema: schemas.get(channel.schemaId), message: record };
      }
    }
  }
}
