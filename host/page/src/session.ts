// The host's side of a conversation (proto/README.md): HELLO, SCHEMA where it is not ours, commands until they are answered.

import { Decoder, encodeCommandFrame, type Frame, PROTOCOL_VERSION } from "./wire/framing";
import { type Decoded, Schema } from "./wire/schema";

const HELLO_EVERY_MS = 500;
const HELLO_PATIENCE = 6; // unanswered HELLOs until the person is told
const REPLY_MS = 500;
const REPLY_TRIES = 12;

export interface Events {
  /** A sensor answered, or answered again; its schema is known. */
  onHello(hello: Decoded, schema: Schema): void;
  onMessage(frame: Frame, name: string, message: Decoded): void;
  /** One sentence for a person; empty: all is well. */
  onProblem(text: string): void;
}

/** What was asked for and not answered, or answered with a refusal. */
export class CommandError extends Error {
  constructor(
    text: string,
    /** ReplyCode of a refusal. */
    readonly code?: number,
  ) {
    super(text);
  }
}

/** One open line. `feed` what comes, `stop` when it is over. */
export class Session {
  readonly decoder = new Decoder();
  /** Messages that are not what their type says. */
  nUndecodable = 0;
  /** Broken frames that a server threw away before they came here. */
  nBrokenBefore = 0;
  private schema: Schema;
  private isGreeted = false;
  private nAsked = 0;
  private sequence = 0;
  /** Who asks: what this host changes is kept apart from what another one does (proto/README.md, the lease). */
  private readonly holder = 1 + Math.floor(Math.random() * 0xfffffffe);
  private requestId = 1 + Math.floor(Math.random() * 0xffffff);
  private readonly waiting = new Map<number, (reply: Decoded) => void>();
  private timer: ReturnType<typeof setTimeout> | undefined;
  private isStopped = false;
  private pendingHello: Decoded | undefined;
  private asked: ((hello: Decoded) => void)[] = []; // who waits for the next HELLO

  constructor(
    private readonly send: (data: Uint8Array) => void,
    private readonly own: Schema,
    private readonly ownSha256: Uint8Array | undefined,
    private readonly events: Events,
  ) {
    this.schema = own;
    this.greet();
  }

  stop(): void {
    this.isStopped = true;
    clearTimeout(this.timer);
  }

  /** Ask who is there, until somebody answers. */
  private greet(): void {
    if (this.isStopped || this.isGreeted) return;
    if (this.nAsked++ >= HELLO_PATIENCE) this.events.onProblem(this.silence());
    this.send(new Uint8Array(1)); // ends whatever a predecessor left half sent
    const name = this.pendingHello ? "SCHEMA" : "HELLO";
    this.send(encodeCommandFrame(this.own.typeNumber(name)!, new Uint8Array(), this.sequence++));
    this.timer = setTimeout(() => this.greet(), HELLO_EVERY_MS);
  }

  private silence(): string {
    const { malformed, bad_crc } = this.decoder.counters;
    const nBroken = malformed + bad_crc + this.nBrokenBefore;
    if (nBroken === 0) return "Nothing answers on this line: is ruffinid running, and is it this port?";
    return (
      `What comes on this line is not protocol version ${PROTOCOL_VERSION} of ruffini (${nBroken} broken frames): ` +
      "another device, or firmware of another version: update the host tools or the sensor."
    );
  }

  feed(data: Uint8Array): void {
    for (const frame of this.decoder.feed(data)) this.receive(frame);
  }

  private receive(frame: Frame): void {
    const name = this.schema.typeName(frame.type);
    if (!name) return; // a type of the future
    const message = this.schema.decode(frame.type, frame.payload);
    if (!message) {
      this.nUndecodable++;
    } else if (name === "HELLO") {
      this.receiveHello(message);
    } else if (name === "SCHEMA") {
      this.receiveSchema(message);
    } else if (name === "REPLY") {
      this.waiting.get(message["requestId"] as number)?.(message);
    } else if (this.isGreeted) {
      this.events.onMessage(frame, name, message);
    }
  }

  private receiveHello(hello: Decoded): void {
    if (hello["protocolVersion"] !== PROTOCOL_VERSION) {
      this.events.onProblem(
        `The sensor speaks protocol version ${hello["protocolVersion"]}, this page version ${PROTOCOL_VERSION}: update the older one.`,
      );
      this.stop();
      return;
    }
    if (this.isGreeted) {
      this.events.onHello(hello, this.schema);
      for (const answer of this.asked.splice(0)) answer(hello);
      return;
    }
    const isOurs = this.ownSha256 !== undefined && isEqual(hello["schemaSha256"] as Uint8Array, this.ownSha256);
    if (isOurs) {
      this.begin(hello, this.own);
      return;
    }
    const isFirst = this.pendingHello === undefined;
    this.pendingHello = hello;
    if (isFirst) {
      clearTimeout(this.timer);
      this.greet();
    }
  }

  private receiveSchema(message: Decoded): void {
    if (!this.pendingHello || this.isGreeted) return;
    try {
      this.begin(this.pendingHello, new Schema(message["fileDescriptorSet"] as Uint8Array));
    } catch {
      this.events.onProblem("The schema that the sensor sends cannot be read: update its firmware.");
    }
  }

  private begin(hello: Decoded, schema: Schema): void {
    clearTimeout(this.timer);
    this.schema = schema;
    this.isGreeted = true;
    this.events.onProblem("");
    this.events.onHello(hello, schema);
  }

  /** Who is there now, once `onHello` was told, too: what it is calibrated with may have changed. Rejects with CommandError. */
  askWho(): Promise<Decoded> {
    const answer = new Promise<Decoded>((resolve) => this.asked.push(resolve));
    const send = (): void => this.send(encodeCommandFrame(this.own.typeNumber("HELLO")!, new Uint8Array(), this.sequence++));
    return this.repeated("HELLO", send, answer, REPLY_MS, REPLY_TRIES);
  }

  /** One command, repeated under the same id until it is answered. Rejects with CommandError, also on a refusal. */
  async command(name: string, value: Record<string, unknown> = {}, waitMs = REPLY_MS, tries = REPLY_TRIES): Promise<Decoded> {
    const reply = await this.ask(name, value, waitMs, tries);
    if (reply["code"] !== 0) {
      throw new CommandError(String(reply["text"]) || `The sensor refuses ${name}.`, Number(reply["code"]));
    }
    return reply;
  }

  /** Likewise, whatever the answer; a try without one lasts `waitMs`. */
  ask(name: string, value: Record<string, unknown>, waitMs: number, nTries: number): Promise<Decoded> {
    const id = this.requestId;
    this.requestId = (this.requestId % 0xffffffff) + 1;
    const payload = this.schema.encode("Command", { requestId: id, holder: this.holder, action: { case: name, value } });
    const type = this.schema.typeNumber("COMMAND")!;
    const answer = new Promise<Decoded>((resolve) => this.waiting.set(id, resolve));
    const send = (): void => {
      this.send(new Uint8Array(1));
      this.send(encodeCommandFrame(type, payload, this.sequence++));
    };
    return this.repeated(name, send, answer, waitMs, nTries).finally(() => this.waiting.delete(id));
  }

  /** The answer to what is sent at once and again every `waitMs` until it comes. */
  private repeated(name: string, send: () => void, answer: Promise<Decoded>, waitMs: number, nTries: number): Promise<Decoded> {
    return new Promise((resolve, reject) => {
      let nSent = 0;
      let timer: ReturnType<typeof setTimeout>;
      const again = (): void => {
        if (this.isStopped || nSent++ >= nTries) {
          reject(new CommandError(`No reply to ${name}: is the sensor still there?`));
          return;
        }
        send();
        timer = setTimeout(again, waitMs);
      };
      void answer.then((reply) => {
        clearTimeout(timer);
        resolve(reply);
      });
      again();
    });
  }

  /** Ask for each n-th message of a type; types that the sensor does not know are left out. */
  subscribe(every: Record<string, number>): Promise<Decoded> {
    const subscriptions = Object.entries(every)
      .map(([name, n]) => ({ type: this.schema.typeNumber(name.toUpperCase()), every: n }))
      .filter(({ type }) => type !== undefined);
    return this.command("subscribe", { subscriptions });
  }
}

export function isEqual(a: Uint8Array, b: Uint8Array): boolean {
  return a.length === b.length && a.every((byte, i) => byte === b[i]);
}
