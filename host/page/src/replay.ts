// A recording in the place of a sensor: the bytes as they came, at the pace at which they came.

import { type IReadable, McapIndexedReader } from "@mcap/core";
import { decompress as unzstd } from "fzstd";
import { RAW_TOPIC } from "./recording";
import { type Decoded, Schema } from "./wire/schema";

const HELLO_TOPIC = "/ruffini/hello";
const MAX_CHUNK_BYTES = 256 << 20; // no recorder of ours writes larger ones
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

export class Replay {
  private constructor(
    private readonly reader: McapIndexedReader,
    readonly schema: Schema,
    readonly hello: Decoded,
  ) {}

  /** Rejects with BadRecording. */
  static async open(file: Blob): Promise<Replay> {
    try {
      const zstd = (buffer: Uint8Array, size: bigint): Uint8Array => {
        if (size > MAX_CHUNK_BYTES) throw new BadRecording("a chunk of it is larger than any of ours");
        return unzstd(buffer, new Uint8Array(Number(size)));
      };
      const reader = await McapIndexedReader.Initialize({ readable: new BlobReader(file), decompressHandlers: { zstd } });
      return await Replay.of(reader);
    } catch (error) {
      if (error instanceof BadRecording) throw error;
      throw new BadRecording(`it is no MCAP file, or was cut short (${String(error).slice(0, 120)})`);
    }
  }

  private static async of(reader: McapIndexedReader): Promise<Replay> {
    const channels = [...reader.channelsById.values()];
    const hello = channels.find((c) => c.topic === HELLO_TOPIC);
    if (!hello || !channels.some((c) => c.topic === RAW_TOPIC)) {
      throw new BadRecording("it does not say what sensor it is of: record with `ruffini record` of this version, or from this page");
    }
    const schema = new Schema(reader.schemasById.get(hello.schemaId)!.data);
    for await (const message of reader.readMessages({ topics: [HELLO_TOPIC] })) {
      const decoded = schema.decode(schema.typeNumber("HELLO")!, message.data);
      if (decoded) return new Replay(reader, schema, decoded);
    }
    throw new BadRecording("its HELLO cannot be read");
  }

  /** Hands over the bytes at their pace; true when the end was reached, false when `isOver` said so. */
  async play(feed: (data: Uint8Array) => void, isOver: () => boolean): Promise<boolean> {
    let before = 0n; // also the stamp of what came before the first result
    for await (const message of this.reader.readMessages({ topics: [RAW_TOPIC] })) {
      const waitMs = !before ? 0 : Number(message.logTime - before) / 1e6;
      before = message.logTime;
      if (waitMs > 0) await new Promise((resolve) => setTimeout(resolve, Math.min(waitMs, MAX_PAUSE_MS)));
      if (isOver()) return false;
      feed(message.data);
    }
    return true;
  }
}
