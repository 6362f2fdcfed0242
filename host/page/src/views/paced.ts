// Work that need not follow each field: what is read by eye, not watched.

/** Does its work at most once in so many milliseconds, and never leaves the newest undone. */
export class Paced {
  private isAsked = false;
  private lastMs = -Infinity;

  constructor(
    private readonly everyMs: number,
    private readonly work: () => void,
  ) {}

  /** There is something new. */
  ask(): void {
    this.isAsked = true;
  }

  /** To be called with each picture of the screen. */
  tick(nowMs: number): void {
    if (!this.isAsked || nowMs - this.lastMs < this.everyMs) return;
    this.lastMs = nowMs;
    this.flush();
  }

  /** At once. */
  flush(): void {
    this.isAsked = false;
    this.work();
  }
}
