// Is the line well, is the sensor well: rates, losses by cause, delays, temperatures.

import { WINDOW_MS } from "../delays";
import { DELAY_BIN_MS, type LineHealth, N_DELAY_BINS, type Status } from "../messages";
import { fillTable, make, spaced, words, write } from "./dom";
import { Paced } from "./paced";

const EVERY_MS = 500;

export class Health {
  readonly element = make("section", { class: "health", "aria-label": "Link and health" });
  private readonly rates = make("tbody");
  private readonly drops = make("tbody");
  private readonly stages = make("tbody");
  private readonly bars = make("div", { class: "bars", role: "img" });
  private readonly state = make("p", { class: "state" });
  private deviceDrops: [string, number][] = [];
  private newest: LineHealth | undefined;
  /** Its rates and losses. */
  readonly tables = new Paced(EVERY_MS, () => this.newest && this.showLine(this.newest));

  constructor() {
    const table = (title: string, body: HTMLElement): HTMLElement => make("table", {}, make("caption", {}, title), body);
    this.element.append(
      make("h2", {}, "Link and health"),
      this.state,
      make("div", { class: "tables" }, table("Rates", this.rates), table("Lost, by cause", this.drops), table("Stages, mean and longest", this.stages)),
      make("figure", {}, make("figcaption", {}, `Delay over the fastest frame of the last ${WINDOW_MS / 1e3} s, bins of ${DELAY_BIN_MS} ms, the last one all above`), this.bars),
    );
  }

  /** `stages`: those of the board's pipeline. */
  showStatus(status: Status, stages: string[]): void {
    const well = status.health.length ? status.health.map(words).join(", ") : "all well";
    const warm = status.temperatures.map(([place, c]) => `${place} ${c.toFixed(1)} °C`).join(", ");
    const up = `up ${status.uptimeS >= 3600 ? `${(status.uptimeS / 3600).toFixed(1)} h` : `${status.uptimeS.toFixed(0)} s`}`;
    const said = [`camera ${status.frameRateHz.toFixed(1)} frames/s`, well, up, warm].filter(Boolean).join(" · ");
    write(this.state, said);
    this.state.classList.toggle("bad", status.health.length > 0);
    this.deviceDrops = [...status.drops, ["saturations", status.saturations]];
    const own = status.stages.filter(([name]) => stages.includes(name));
    fillTable(this.stages, own.map(([name, mean, most]) => [name, `${mean.toFixed(2)} ms`, `${most.toFixed(2)} ms`]));
  }

  keep(health: LineHealth): void {
    this.newest = health;
    this.tables.ask();
  }

  private showLine(health: LineHealth): void {
    fillTable(this.rates, [
      ["bytes", `${(health.bytesPerS / 1e3).toFixed(0)} kB/s`],
      ...health.perS.map(([name, n]) => [words(name), `${n.toFixed(1)} /s`]),
    ]);
    const { counters } = health;
    const here: [string, number][] = [
      ...Object.entries(counters).map(([name, n]): [string, number] => [words(name), n]),
      ["undecodable", health.nUndecodable],
      ["not sent: slow page", health.notSent],
      ["not drawn: newer came", health.notShown],
    ];
    const device = this.deviceDrops.map(([name, n]): string[] => ["sensor", spaced(name), String(n)]);
    fillTable(this.drops, [...device, ...here.map(([name, n]) => ["page", name, String(n)])]);
    this.showDelays(health.delays);
  }

  private showDelays(delays: number[]): void {
    const most = Math.max(...delays, 1);
    const total = delays.reduce((a, b) => a + b, 0);
    while (this.bars.childElementCount < N_DELAY_BINS) this.bars.append(make("i"));
    delays.forEach((n, i) => {
      const bar = this.bars.children[i] as HTMLElement;
      bar.style.height = `${(100 * n) / most}%`;
      bar.title = `${i * DELAY_BIN_MS} ms: ${n}`;
    });
    const within = delays.slice(0, 5).reduce((a, b) => a + b, 0);
    this.bars.setAttribute("aria-label", `${total ? Math.round((100 * within) / total) : 0} % within ${5 * DELAY_BIN_MS} ms of the fastest`);
  }
}
