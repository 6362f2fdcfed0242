// Strip charts of force and moment: the last seconds, a gap where there is no valid number.

import uPlot from "uplot";
import { AXIS_COLOURS } from "./colours";
import type { Unit } from "./units";

const SPAN_S = 10;
const ROW = 7; // capture time and six values
const MAX_POINTS = 2400; // 10 s at 240 frames a second
const HEIGHT_PX = 150;

export class Charts {
  readonly element = document.createElement("div");
  private readonly time: number[] = [];
  private readonly values: number[][] = Array.from({ length: 6 }, () => []);
  private plots: uPlot[] = [];
  private unit: Unit;

  constructor(unit: Unit) {
    this.element.className = "charts";
    this.unit = unit;
    this.rebuild(unit);
    new ResizeObserver(() => this.resize()).observe(this.element);
  }

  get nPoints(): number {
    return this.time.length;
  }

  /** Rebuild the plots: units or colours have changed. */
  rebuild(unit: Unit): void {
    this.unit = unit;
    for (const plot of this.plots) plot.destroy();
    this.plots = [
      this.make("Force", unit.name, ["Fx", "Fy", "Fz"]),
      this.make("Moment", unit.momentName, ["Tx", "Ty", "Tz"]),
    ];
    this.drawStrips();
  }

  private make(title: string, unit: string, names: string[]): uPlot {
    const style = getComputedStyle(document.documentElement);
    const axis = { stroke: style.getPropertyValue("--ink"), grid: { stroke: style.getPropertyValue("--grid") }, ticks: { show: false } };
    return new uPlot(
      {
        width: this.width(),
        height: HEIGHT_PX,
        title: `${title}, ${unit}`,
        cursor: { drag: { x: false, y: false } },
        legend: { show: true, live: false },
        scales: { x: { time: false }, y: { range: (_, low, high) => room(low, high) } },
        axes: [
          { ...axis, size: 24, values: (_, splits) => splits.map((s) => `${Number.isInteger(s) ? s : s.toFixed(1)} s`) },
          { ...axis, size: 54 },
        ],
        series: [
          {},
          ...names.map((label, i) => ({ label, stroke: AXIS_COLOURS[i]!, width: 1.5, spanGaps: false, points: { show: false } })),
        ],
      },
      [[], [], [], []],
      this.element,
    );
  }

  /** Side by side where there is room. */
  private width(): number {
    const all = this.element.clientWidth;
    return Math.max(all > 600 ? (all - 17) / 2 : all, 200);
  }

  private resize(): void {
    for (const plot of this.plots) plot.setSize({ width: this.width(), height: HEIGHT_PX });
  }

  /** Rows of capture time, three forces (N), three moments (N m); NaN is a gap. */
  add(trace: Float64Array): void {
    for (let at = 0; at + ROW <= trace.length; at += ROW) {
      const time = trace[at]!;
      if (this.time.length && time < this.time.at(-1)!) this.clear(); // the sensor was started again
      if (time === this.time.at(-1)) continue; // sent again while the camera stands still
      this.time.push(time);
      this.values.forEach((list, i) => list.push(trace[at + 1 + i]!));
    }
    const old = this.time.findIndex((t) => t > (this.time.at(-1) ?? 0) - SPAN_S);
    const nOld = Math.max(old, this.time.length - MAX_POINTS);
    if (nOld > 0) for (const list of [this.time, ...this.values]) list.splice(0, nOld);
  }

  private clear(): void {
    for (const list of [this.time, ...this.values]) list.length = 0;
  }

  drawStrips(): void {
    const now = this.time.at(-1) ?? 0;
    const ago = this.time.map((t) => t - now);
    this.plots.forEach((plot, i) => {
      const scale = i === 0 ? this.unit.perN : this.unit.perNm;
      const rows = this.values.slice(3 * i, 3 * i + 3).map((list) => list.map((v) => (Number.isNaN(v) ? null : v * scale)));
      plot.setData([ago, ...rows] as uPlot.AlignedData, false);
      plot.setScale("x", { min: -SPAN_S, max: 0 });
    });
  }
}

/** Some room above and below, and no trembling axis where nothing happens. */
function room(low: number | null, high: number | null): [number, number] {
  if (low === null || high === null) return [-1, 1];
  const slack = Math.max(0.08 * (high - low), 0.02, 0.02 * Math.max(Math.abs(low), Math.abs(high)));
  return [low - slack, high + slack];
}
