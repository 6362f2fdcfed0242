// How finely the three dimensions are drawn: as the computer can, without a setting.

const RATIOS = [0.5, 0.75, 1, 1.5, 2]; // pixels of the picture for one of the style sheet
const WINDOW = 15; // pictures of which the middle one counts: a pause for something else is none of ours
const FIRST_PATIENCE = 60; // quick pictures before a finer one is tried
const MOST_PATIENCE = 7680; // two minutes at 60 a second

/** Picks the ratio from what a picture costs; ratios up to `finest`, starting at `start`. */
export class Quality {
  private readonly ratios: number[];
  private at: number;
  private costs: number[] = [];
  private nQuick = 0;
  private patience = FIRST_PATIENCE;
  private nSinceRaised = Infinity;

  /** Above `slowMs` a picture is too fine; below `quickMs` a finer one is tried, seldomer each time that fails. */
  constructor(
    finest: number,
    start: number,
    private readonly slowMs: number,
    private readonly quickMs: number,
  ) {
    this.ratios = RATIOS.filter((ratio) => ratio < finest).concat(finest);
    this.at = this.ratios.findLastIndex((ratio) => ratio <= start);
    if (this.at < 0) this.at = 0;
  }

  get ratio(): number {
    return this.ratios[this.at]!;
  }

  /** A picture was drawn and took so long. */
  note(costMs: number): void {
    this.nSinceRaised++;
    this.costs.push(costMs);
    if (this.costs.length < WINDOW) return;
    const middle = this.costs.sort((a, b) => a - b)[WINDOW >> 1]!;
    this.costs = [];
    if (middle > this.slowMs) this.lower();
    else if (middle >= this.quickMs) this.nQuick = 0;
    else if ((this.nQuick += WINDOW) >= this.patience) this.raise();
  }

  private lower(): void {
    // What was tried a moment ago was too much.
    if (this.nSinceRaised < FIRST_PATIENCE) this.patience = Math.min(2 * this.patience, MOST_PATIENCE);
    this.nQuick = 0;
    this.nSinceRaised = Infinity;
    this.at = Math.max(this.at - 1, 0);
  }

  private raise(): void {
    this.nQuick = 0;
    if (this.at === this.ratios.length - 1) return;
    this.nSinceRaised = 0;
    this.at++;
  }
}
