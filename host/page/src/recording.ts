// The stream as MCAP, as `ruffini record` writes it: each message with its schema, and the bytes as they came.

import { McapWriter } from "@mcap/core";
import type { Schema } from "./wire/schema";

export const RAW_TOPIC = "/ruffini/raw";
const MAX_BYTES = 512 << 20; // held in memory until it is saved

export class Recording {
  nBytes = 0;
  nMessages = 0;
  private readonly parts: Uint8Array<ArrayBuffer>[] = [];
  private readonly channels = new Map<string, Promise<number>>();
  private clockNs = 0n;
  private readonly writer = new McapWriter({
    writable: {
      position: () => BigInt(this.nBytes),
      write: (buffer) => {
        this.parts.push(buffer.slice());
        this.nBytes += buffer.length;
        return Promise.resolve();
      },
    },
  });
  private last: Promise<unknown>; // one after the other

  /** `hello`: what the sensor is, so that the file can be shown without it. */
  constructor(
    private readonly schema: Schema,
    hello: Uint8Array,
  ) {
    this.last = this.writer.start({ profile: "ruffini", library: "ruffini page" });
    this.addMessage("HELLO", 0, hello);
  }

  get isFull(): boolean {
    return this.nBytes > MAX_BYTES;
  }

  /** Bytes as they came, stamped with the newest capture time before them. */
  addRaw(data: Uint8Array): void {
    this.add(RAW_TOPIC, 0, data.slice(), () =>
      this.writer.registerChannel({ topic: RAW_TOPIC, messageEncoding: "application/octet-stream", schemaId: 0, metadata: new Map() }),
    );
  }

  addMessage(name: string, sequence: number, payload: Uint8Array, captureUs?: bigint): void {
    if (captureUs !== undefined) this.clockNs = captureUs * 1000n;
    this.nMessages++;
    this.add(`/ruffini/${name.toLowerCase()}`, sequence, payload, async (topic) => {
      const pascal = name.toLowerCase().replace(/(?:^|_)([a-z])/g, (_, c: string) => c.toUpperCase());
      const schemaId = await this.writer.registerSchema({ name: `ruffini.${pascal}`, encoding: "protobuf", data: this.schema.bytes });
      return this.writer.registerChannel({ topic, messageEncoding: "protobuf", schemaId, metadata: new Map() });
    });
  }

  private add(topic: string, sequence: number, data: Uint8Array, register: (topic: string) => Promise<number>): void {
    const time = this.clockNs;
    this.last = this.last.then(async () => {
      let channel = this.channels.get(topic);
      if (!channel) this.channels.set(topic, (channel = register(topic)));
      await this.writer.addMessage({ channelId: await channel, sequence, logTime: time, publishTime: time, data });
    });
  }

  /** The whole file. */
  async finish(): Promise<Blob> {
    await this.last;
    await this.writer.end();
    return new Blob(this.parts, { type: "application/octet-stream" });
  }
}
