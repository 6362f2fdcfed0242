// One line of a sensor, seen from the page: its worker, and what was asked through it.

import type { Guide } from "./guide";
import type { Answer, FromWorker, Hello, Snapshot, ToWorker } from "./messages";

export interface LineEvents {
  onHello(hello: Hello): void;
  onSnapshot(snapshot: Snapshot): void;
  onGuide(guide: Guide): void;
  onOpen(): void;
  onFlashing(part: number, text: string, isOver: boolean, isOk: boolean): void;
  /** A recording was ended: here is the file. */
  onRecorded(blob: Blob, nMessages: number): void;
  /** One sentence; empty: all is well. */
  onProblem(text: string): void;
}

export class Line {
  port = "";
  isOpen = false;
  private readonly worker = new Worker(new URL("worker.js", document.baseURI), { type: "module" });
  private readonly answers = new Map<number, (answer: Answer) => void>();
  private nAsked = 0;
  private onClosed: () => void = () => undefined;

  constructor(private readonly events: LineEvents) {
    this.worker.onmessage = ({ data }: MessageEvent<FromWorker>) => this.hear(data);
    this.worker.onerror = (event) => events.onProblem(`The page has a fault: ${event.message}`);
  }

  tell(message: ToWorker, transfer: Transferable[] = []): void {
    this.worker.postMessage(message, transfer);
  }

  /** Always resolves: with what the sensor says, or why it says nothing. */
  command(name: string, value: Record<string, unknown> = {}): Promise<Answer> {
    const id = ++this.nAsked;
    return new Promise((resolve) => {
      this.answers.set(id, resolve);
      this.tell({ kind: "command", id, name, value });
    });
  }

  private hear(message: FromWorker): void {
    if (message.kind === "hello") this.events.onHello(message.hello);
    else if (message.kind === "snapshot") this.events.onSnapshot(message.snapshot);
    else if (message.kind === "guide") this.events.onGuide(message.guide);
    else if (message.kind === "recorded") this.events.onRecorded(message.blob, message.nMessages);
    else if (message.kind === "flashing") this.events.onFlashing(message.part, message.text, message.isOver, message.isOk);
    else if (message.kind === "closed") this.onClosed();
    else if (message.kind === "problem") this.events.onProblem(message.text);
    else if (message.kind === "line") {
      this.isOpen = message.isOpen;
      if (message.port) this.port = message.port;
      if (message.isOpen) this.events.onOpen();
      else this.events.onProblem(message.text);
    } else {
      this.answers.get(message.id)?.(message.answer);
      this.answers.delete(message.id);
    }
  }

  /** Resolves when a recording that was under way is handed over, and the line let go of. */
  close(): Promise<void> {
    const closed = new Promise<void>((resolve) => (this.onClosed = resolve));
    this.tell({ kind: "close" });
    return closed;
  }
}
