// Guides a person through a collection: where to press, how hard, for how long, and how good it is.

import type { SensorInfo } from "../board";
import { type Guide, largestGap, type Load, type Quality, type Step } from "../guide";
import { enterOf } from "../keys";
import { button, make } from "./dom";
import { text } from "./units";

const MARGIN = 0.08; // of the pad's length, round its picture
const RING_PX = 15;
const DOT_PX = 4;
const ROOM = 1.5; // of the wanted load: the length of its bar
const MARKS: Record<string, string> = { true: "✓", false: "✗", undefined: "·" };

/** "done" or "stop", and what was typed. */
export type AnswerTo = (word: "done" | "stop", typed: string) => void;
/** What was chosen at a step, with its form as it is filled in. */
export type Choose = (word: string, step: number, fields: Record<string, string>) => void;

export class GuidePanel {
  readonly element = make("section", { class: "guide", "aria-label": "Calibration" });
  private readonly program = make("h2");
  private readonly said = make("p", { class: "said", role: "status", "aria-live": "assertive" });
  private readonly typed = make("input", { type: "text", inputmode: "decimal", maxlength: "20", size: "8", autocomplete: "off", "aria-label": "What the scale shows, in grams" });
  private readonly unit = make("label", { class: "typed" }, this.typed, "g");
  private readonly done: HTMLButtonElement;
  private readonly stop: HTMLButtonElement;
  private readonly pad = make("canvas", { class: "pad", role: "img" });
  private readonly where = make("p", { class: "where" });
  private readonly load = new LoadBar();
  private readonly held = make("progress", { max: "1", "aria-label": "Held" });
  private readonly heldRow = make("div", { class: "held" }, make("span", {}, "held"), this.held);
  private readonly touches = make("progress", { "aria-label": "Touches" });
  private readonly counts = make("p", { class: "counts" });
  private readonly quality = make("tbody");
  private readonly setAside = make("ul");
  private readonly setAsideTitle = make("h3", {}, "Set aside, to be done again");
  private readonly end = make("p", { class: "end", role: "status", "aria-live": "polite" });
  private readonly work = make("progress", { max: "1", "aria-label": "Done so far" });
  private readonly form = make("div", { class: "form" });
  private readonly choices = make("div", { class: "choices" });
  private readonly gates = make("tbody");
  private readonly gateTable = make("table", { class: "gates" }, make("caption", {}, "Gates"), this.gates);
  // No script of a report runs, wherever its file comes from.
  private readonly report = make("iframe", { class: "report", sandbox: "", title: "Report" });
  private readonly columns: HTMLElement;
  private isOver = false;
  private stepNumber = -1; // that is shown
  latest: Guide | undefined;

  private asked = 0;

  constructor(
    answer: AnswerTo,
    private readonly chosen: Choose,
    private readonly reportUrl: string,
  ) {
    this.done = button("Done", "Enter", "it is as it was asked for", () => this.latest?.asked && answer("done", this.typed.value));
    this.stop = button("Stop", "X", "end here; what was collected is kept", () => !this.isOver && answer("stop", ""));
    this.stop.classList.add("stop");
    const quality = make("table", {}, make("caption", {}, "Right now"), this.quality);
    this.columns = make(
      "div",
      { class: "columns" },
      make("figure", {}, this.pad, make("figcaption", {}, this.where)),
      make("div", { class: "rows" }, this.load.element, this.heldRow, quality, this.setAsideTitle, this.setAside),
    );
    this.element.append(
      make("header", {}, this.program, this.counts, this.touches, this.stop),
      make("div", { class: "ask" }, this.said, this.unit, this.done, this.end),
      this.work,
      this.form,
      this.choices,
      this.columns,
      this.gateTable,
      this.report,
    );
  }

  choose(word: string): void {
    const fields = [...this.form.querySelectorAll("input")].map((input) => [input.name, input.value]);
    if (this.latest?.step) this.chosen(word, this.latest.step.number, Object.fromEntries(fields) as Record<string, string>);
  }

  /** Keys of its buttons, as the page's own. */
  get buttons(): HTMLButtonElement[] {
    return [this.done, this.stop, ...this.choices.querySelectorAll("button")];
  }

  show(guide: Guide, info: SensorInfo | undefined): void {
    this.latest = guide;
    const isPress = !guide.step || guide.step.phase === "press";
    this.isOver = guide.end !== undefined || !isPress;
    this.element.hidden = guide.step?.phase === "";
    if (this.element.hidden) return;
    this.showStep(guide.step);
    this.program.textContent = `Calibration: ${guide.program}`;
    this.columns.hidden = this.counts.hidden = this.touches.hidden = !isPress;
    say(this.said, guide.end ? (guide.end.isOk ? "Complete." : "It has ended.") : guide.said);
    this.done.hidden = !guide.asked || this.isOver;
    this.stop.hidden = this.isOver;
    this.showTyped(guide);
    say(this.end, guide.end ? `${guide.end.text.replace(/\.?$/, ".")} ${guide.end.next}` : (guide.step?.text ?? ""));
    this.end.classList.toggle("bad", guide.end?.isOk === false || guide.step?.isBad === true);
    if (!isPress) return;
    this.showCounts(guide);
    this.load.show(this.isOver ? undefined : guide.load);
    this.heldRow.classList.toggle("idle", guide.held === undefined || this.isOver);
    this.held.value = guide.held ?? 0;
    this.showQuality(this.isOver ? [] : guide.quality);
    const aside = guide.setAside.join("\n");
    if (this.setAside.dataset["said"] !== aside) {
      this.setAside.dataset["said"] = aside;
      this.setAside.replaceChildren(...guide.setAside.map((why) => make("li", {}, why)));
    }
    this.setAsideTitle.hidden = !aside;
    this.drawPad(guide, info);
  }

  /** A step's form, buttons and report are made once, so that nothing that a person types is lost. */
  private showStep(step: Step | undefined): void {
    this.work.hidden = step?.phase !== "work";
    if (step?.part === undefined) this.work.removeAttribute("value");
    else this.work.value = step.part;
    const number = step?.number ?? -1;
    if (number === this.stepNumber) return;
    this.stepNumber = number;
    this.form.replaceChildren(...(step?.fields ?? []).map((field) => make("label", {}, `${field.label} `, make("input", { type: "text", name: field.name, value: field.value, size: "18", maxlength: "100", autocomplete: "off" }), ` ${field.unit}`)));
    const entered = step && enterOf(step);
    this.choices.replaceChildren(...(step?.choices ?? []).map((c) => button(c.label, c.word === entered ? "Enter" : "", c.hint, () => this.choose(c.word))));
    this.gateTable.hidden = !step?.gates.length;
    this.gates.replaceChildren(
      ...(step?.gates ?? []).map(({ name, ok, text: what, remedy }) => {
        const mark = make("td", { class: "mark" }, MARKS[String(ok)]!);
        const said = remedy ? `${what}. To mend it: ${remedy}.` : what;
        return make("tr", ok === undefined ? {} : { class: ok ? "ok" : "bad" }, mark, make("th", { scope: "row" }, name), make("td", {}, said));
      }),
    );
    this.report.hidden = step?.report === undefined;
    if (step?.report !== undefined) this.report.src = `${this.reportUrl}?${step.report}`;
  }

  /** Empty and ready to be typed into at each new question. */
  private showTyped({ asked, wantsNumber }: Guide): void {
    this.unit.hidden = !wantsNumber || this.isOver;
    if (this.unit.hidden || asked === this.asked) return;
    this.asked = asked;
    this.typed.value = "";
    this.typed.focus();
  }

  private showCounts({ nDone, nTotal, nRedone, touches }: Guide): void {
    const gap = largestGap(touches);
    const redone = nRedone ? ` · ${nRedone} done again` : "";
    const cover = !gap ? "" : ` · no place of the plan further than ${text(gap, 1)} mm from a touch`;
    say(this.counts, nTotal ? `${nDone} of ${nTotal} touches${redone}${cover}` : "no touch yet");
    this.touches.max = Math.max(nTotal, 1);
    this.touches.value = nDone;
  }

  private showQuality(quality: Quality[]): void {
    this.quality.replaceChildren(
      ...quality.map(({ name, ok, text: what }) => {
        const mark = make("td", { class: "mark" }, MARKS[String(ok)]!);
        return make("tr", ok === undefined ? {} : { class: ok ? "ok" : "bad" }, mark, make("th", { scope: "row" }, name), make("td", {}, what));
      }),
    );
  }

  /** As a person sees the pad: x to the right, y up. */
  private drawPad(guide: Guide, info: SensorInfo | undefined): void {
    const [w, h] = [(info?.padX ?? 0.02) * 1e3, (info?.padY ?? 0.02) * 1e3];
    const where = guide.target && !this.isOver ? `${guide.touches.length ? "Press in the ring" : "Next"}: x ${text(guide.target.x, 1)}, y ${text(guide.target.y, 1)} mm. ` : "";
    this.pad.hidden = !guide.touches.length;
    say(this.where, guide.touches.length ? `${where}As you see the pad from where you press: x to the right, y up.` : where);
    if (this.pad.hidden) return;
    const margin = MARGIN * Math.max(w, h);
    this.pad.style.aspectRatio = String((w + 2 * margin) / (h + 2 * margin));
    const ratio = Math.min(window.devicePixelRatio, 2);
    const [cw, ch] = [(this.pad.clientWidth || 320) * ratio, (this.pad.clientHeight || 240) * ratio];
    if (this.pad.width !== Math.round(cw)) this.pad.width = Math.round(cw);
    if (this.pad.height !== Math.round(ch)) this.pad.height = Math.round(ch);
    const context = this.pad.getContext("2d")!;
    const perMm = Math.min(this.pad.width / (w + 2 * margin), this.pad.height / (h + 2 * margin));
    const at = (x: number, y: number): [number, number] => [this.pad.width / 2 + x * perMm, this.pad.height / 2 - y * perMm];
    const colour = (name: string): string => getComputedStyle(this.pad).getPropertyValue(name).trim();
    context.clearRect(0, 0, this.pad.width, this.pad.height);
    context.fillStyle = colour("--stage");
    context.strokeStyle = colour("--faint");
    context.lineWidth = ratio;
    const [left, top] = at(-w / 2, h / 2);
    context.fillRect(left, top, w * perMm, h * perMm);
    context.strokeRect(left, top, w * perMm, h * perMm);
    for (const t of guide.touches) {
      context.beginPath();
      context.arc(...at(t.x, t.y), DOT_PX * ratio, 0, 2 * Math.PI);
      context.fillStyle = colour("--accent");
      context.strokeStyle = colour("--faint");
      if (t.isDone) context.fill();
      else context.stroke();
    }
    this.pad.setAttribute("aria-label", `The pad; ${where}${guide.nDone} of ${guide.nTotal} places are touched.`);
    if (guide.target && !this.isOver) this.ring(context, at(guide.target.x, guide.target.y), ratio, colour("--warn"));
  }

  private ring(context: CanvasRenderingContext2D, [x, y]: [number, number], ratio: number, colour: string): void {
    const r = RING_PX * ratio;
    context.strokeStyle = colour;
    context.lineWidth = 3 * ratio;
    context.beginPath();
    context.arc(x, y, r, 0, 2 * Math.PI);
    for (const [dx, dy] of [[1, 0], [-1, 0], [0, 1], [0, -1]] as const) {
      context.moveTo(x + 0.55 * dx * r, y + 0.55 * dy * r);
      context.lineTo(x + 1.5 * dx * r, y + 1.5 * dy * r);
    }
    context.stroke();
  }
}

/** A live region speaks when its text is set, so it is set only when it changes. */
function say(element: HTMLElement, what: string): void {
  if (element.textContent !== what) element.textContent = what;
  element.hidden = !what;
}

/** The load now, beside the band of what is wanted. */
class LoadBar {
  readonly element = make("div", { class: "load" });
  private readonly now = make("output");
  private readonly wanted = make("span", { class: "faint" });
  private readonly bar = make("i", { class: "now" });
  private readonly band = make("i", { class: "band" });
  private readonly sensor = make("i", { class: "sensor-now" });

  constructor() {
    const bars = make("div", { class: "track", role: "meter", "aria-label": "Force", "aria-valuemin": "0" }, this.band, this.bar, this.sensor);
    this.element.append(make("p", {}, this.now, this.wanted), bars);
  }

  show(load: Load | undefined): void {
    this.element.classList.toggle("idle", !load);
    if (!load) return;
    const room = ROOM * load.high;
    const part = (value: number): string => `${(100 * Math.min(Math.max(value / room, 0), 1)).toFixed(1)}%`;
    const { low, high, now, sensor, unit } = load;
    const digits = unit === "N" ? 2 : 0;
    this.now.textContent = now === undefined ? "–" : `${text(now, digits)} ${unit}`;
    const seen = sensor === undefined ? "" : ` · the sensor says ${text(sensor, digits)} ${unit} (thin line)`;
    this.wanted.textContent = ` of ${text(low, digits)} to ${text(high, digits)} ${unit}${seen}`;
    this.bar.style.width = part(now ?? 0);
    this.band.style.left = part(low);
    this.band.style.width = part(high - low);
    this.sensor.hidden = sensor === undefined;
    this.sensor.style.left = part(sensor ?? 0);
    this.element.dataset["state"] = now === undefined ? "unknown" : now < low ? "less" : now > high ? "more" : "right";
    const track = this.element.querySelector(".track")!;
    track.setAttribute("aria-valuemax", String(room));
    track.setAttribute("aria-valuenow", String(now ?? 0));
  }
}
