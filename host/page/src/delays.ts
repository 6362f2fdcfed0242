// How much later than the fastest of the last seconds each frame came. The clocks of sensor and computer are not the
// same and drift apart, so how late the fastest itself is nobody knows here (`ruffini latency` does).

import { DELAY_BIN_MS, N_DELAY_BINS } from "./messages";

export const WINDOW_MS = 10_000; // in which clocks that differ by 100 ppm drift by half a bin
const MAX_KEPT = 4096;

export class Delays {
  private readonly atMs = new Float64Array(MAX_KEPT);
  private readonly awayMs = new Float64Array(MAX_KEPT); // by two clocks: only differences mean something
  private n = 0; // that ever came; they lie in a ring

  add(nowMs: number, captureMs: number): void {
    this.atMs[this.n % MAX_KEPT] = nowMs;
    this.awayMs[this.n % MAX_KEPT] = nowMs - captureMs;
    this.n++;
  }

  /** How many frames of the window came so late, in bins of DELAY_BIN_MS; the last one has all above. */
  bins(nowMs: number): number[] {
    const out = new Array<number>(N_DELAY_BINS).fill(0);
    const oldest = Math.max(this.n - MAX_KEPT, 0);
    let first = this.n;
    let fastest = Infinity;
    while (first > oldest && this.atMs[(first - 1) % MAX_KEPT]! >= nowMs - WINDOW_MS) {
      first--;
      fastest = Math.min(fastest, this.awayMs[first % MAX_KEPT]!);
    }
    for (let i = first; i < this.n; i++) {
      out[Math.min(Math.floor((this.awayMs[i % MAX_KEPT]! - fastest) / DELAY_BIN_MS), N_DELAY_BINS - 1)]!++;
    }
    return out;
  }
}
