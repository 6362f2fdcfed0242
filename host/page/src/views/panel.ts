// One sensor: its numbers, its field, its maps, its contacts, its charts.

import type { SensorInfo } from "../board";
import type { SensorNews } from "../messages";
import { type Contact, type ContactModel, INVALID, NOT_MEASURED, type Softness, type ToolTouch, VALID, type Wrench } from "../results";
import { Charts } from "./charts";
import { fillTable, make, words, write } from "./dom";
import { Field3d, type Tint } from "./field3d";
import { Maps } from "./maps";
import { Paced } from "./paced";
import { ABSENT, short, text, type Unit, VALIDITY_WORDS } from "./units";

const NAMES = ["Fx", "Fy", "Fz", "Tx", "Ty", "Tz"];
const TEXT_EVERY_MS = 100; // nobody reads faster
const CHART_EVERY_MS = 50;
const SLIP_WORDS = [ABSENT, "sticks", "begins to slip", "slides"];
const CONTACT_HEAD = ["#", "x, y mm", "force", "area mm²", "slip", "more"];

export class Panel {
  readonly element = make("section", { class: "sensor" });
  readonly field: Field3d;
  readonly maps: Maps;
  readonly charts: Charts;
  latest: SensorNews = { trace: new Float64Array() };
  /** Everything that is words; charts. */
  readonly texts = new Paced(TEXT_EVERY_MS, () => this.writeTexts());
  private readonly strips = new Paced(CHART_EVERY_MS, () => this.charts.drawStrips());
  private readonly badges = make("span", { class: "badges" });
  private readonly cells = NAMES.map((name) => new Cell(name));
  private readonly contacts = make("tbody");
  private readonly softness = make("span");
  private readonly learned = make("p", { class: "learned" });
  private readonly scale = make("p", { class: "scale" });
  private readonly legend = make("p", { class: "scale legend" });

  constructor(
    readonly info: SensorInfo,
    private unit: Unit,
    isStill: boolean,
  ) {
    this.maps = new Maps(info, unit);
    this.charts = new Charts(unit);
    const stage = make("div", { class: "stage", tabindex: "0", "aria-label": "Force field in three dimensions: arrow keys turn it" });
    stage.addEventListener("keydown", (event) => {
      if (this.field.press(event.key)) event.preventDefault();
    });
    this.field = new Field3d(info, isStill);
    stage.append(this.field.canvas, this.scale, this.legend);
    new ResizeObserver(([entry]) => this.field.resize(entry!.contentRect.width, entry!.contentRect.height)).observe(stage);
    const c = info.calibration;
    const state = c.isPresent ? `calibrated: ${c.kinds.join(", ")}${c.createdUtc ? `, ${c.createdUtc}` : ""}` : "not calibrated: forces are not measured";
    const head = make("tr", {}, ...CONTACT_HEAD.map((name) => make("th", {}, name)));
    if (!info.fieldForces) this.element.classList.add("bodily");
    const contacts = make(
      "div",
      { class: "contacts" },
      make("table", {}, make("caption", {}, "Contacts", this.softness), make("thead", {}, head), this.contacts),
      this.learned,
    );
    // Maps fill the side of a field; of a body there are few.
    const [side, lower] = info.fieldForces ? [[], [contacts]] : [[contacts], []];
    const inside = make(
      "div",
      { class: "inside" },
      make("header", {}, make("h2", {}, info.product), this.badges, make("p", { class: "calibration" }, state)),
      make("div", { class: "wrench" }, ...this.cells.map((cell) => cell.element)),
      make("div", { class: "middle" }, stage, make("div", { class: "side" }, this.maps.element, ...side)),
      make("div", { class: "lower" }, ...lower, this.charts.element),
    );
    this.element.append(inside);
    this.showNoContacts("none was sent yet");
    this.setTint("normal");
  }

  setUnit(unit: Unit): void {
    this.unit = unit;
    this.charts.rebuild(unit);
    this.maps.setUnit(unit);
    this.texts.flush();
  }

  setTint(tint: Tint): void {
    this.field.tint = tint;
    const tints = { normal: "surface: normal force, dark to bright", slip: "surface: blue sticks, orange slips", plain: "surface: plain" };
    this.legend.textContent = this.info.fieldForces ? `arrows: hue = direction of shear · ${tints[tint]} · depth ×4` : "arrow: force at the contact";
  }

  show(news: SensorNews): void {
    Object.assign(this.latest, news);
    this.showBadges(news);
    if (news.contacts) {
      this.maps.showContacts(news.contacts);
      this.field.showContacts(news.contacts);
    }
    if (news.wrench) this.field.showWrench(news.wrench);
    if (news.field) {
      this.field.moveField(news.field);
      this.maps.showField(news.field);
    }
    if (news.depth) this.maps.showDepth(news.depth);
    if (news.residual) this.maps.showResidual(news.residual);
    if (news.image) this.maps.showImage(news.image);
    this.charts.add(news.trace);
    this.strips.ask();
    this.texts.ask();
  }

  /** With each picture of the screen. */
  draw(nowMs: number): void {
    this.field.drawScene(nowMs);
    this.strips.tick(nowMs);
    this.texts.tick(nowMs);
  }

  private writeTexts(): void {
    const { wrench, contacts, learned } = this.latest;
    if (wrench) this.showWrench(wrench);
    if (contacts) {
      this.showContacts(contacts.contacts);
      write(this.softness, ofSqueeze(contacts.softness));
    }
    if (learned) this.showLearned(learned);
    this.maps.writeRanges();
    this.showScale();
  }

  private showScale(): void {
    const { perN, name, nodePerN, nodeName } = this.unit;
    const whole = `${short(this.field.wrenchFullScaleN * perN)} ${name}`;
    const node = `${short(this.field.nodeFullScaleN * nodePerN)} ${nodeName} at a node, `;
    const said = this.info.fieldForces ? `longest arrow: ${node}${whole} in all` : `longest arrow: ${whole}`;
    write(this.scale, `${said}${this.field.isScaleLocked ? " (locked)" : ""}${this.field.hasCard ? "" : " · no graphics card"}`);
  }

  private showBadges(news: SensorNews): void {
    const list: [string, string][] = [];
    if (news.isSimulated) list.push(["SIMULATED", "simulated"]);
    if (news.isReplay) list.push(["REPLAY", "simulated"]);
    for (const flag of news.flags ?? []) list.push([words(flag), "flag"]);
    if (this.info.calibration.isDevelopmentKey) list.push(["development key", "note"]);
    if (this.info.calibration.isOnTrial) list.push(["calibration on trial", "note"]);
    const said = list.map(([name]) => name).join();
    if (this.badges.dataset["said"] === said) return;
    this.badges.dataset["said"] = said;
    this.badges.replaceChildren(...list.map(([name, kind]) => make("span", { class: `badge ${kind}` }, name)));
  }

  private showWrench(wrench: Wrench): void {
    this.cells.forEach((cell, i) => {
      const { perN, name, digits, perNm, momentName } = this.unit;
      const [per, said, behind] = i < 3 ? [perN, name, digits] : [perNm, momentName, 3];
      cell.show(wrench.values[i]! * per, (wrench.sigma?.[i] ?? NaN) * per, said, behind, wrench.validity[i]!);
    });
  }

  private showNoContacts(why: string): void {
    if (this.contacts.textContent === why) return;
    this.contacts.replaceChildren(make("tr", {}, make("td", { colspan: String(CONTACT_HEAD.length), class: "none" }, why)));
  }

  private showContacts(list: Contact[]): void {
    const { perN, name } = this.unit;
    if (!list.length) {
      const isKnown = !this.latest.wrench?.validity.includes(INVALID);
      this.showNoContacts(isKnown ? "nothing touches" : "not known: see what is flagged above");
      return;
    }
    const rows = list.map((c) => {
      const force = c.force.map((f) => short(f * perN)).join(", ");
      const slip = c.slipState ? `${SLIP_WORDS[c.slipState] ?? "?"}, ${short(c.shearRatio)} of ${short(c.friction)}` : ABSENT;
      const place = `${short(c.center[0] * 1e3)}, ${short(c.center[1] * 1e3)}`;
      return [String(c.id), place, `${force} ${name}`, short(c.areaM2 * 1e6), slip, this.more(c)];
    });
    fillTable(this.contacts, rows);
  }

  private more(c: Contact): string {
    const { perN, name } = this.unit;
    const said: string[] = [];
    if (c.validity === INVALID) said.push("invalid");
    else if (c.validity !== VALID) said.push(VALIDITY_WORDS[c.validity]!);
    if (!Number.isNaN(c.slipMarginN)) said.push(`${short(c.slipMarginN * perN)} ${name} left`);
    if (c.slipShare > 0) said.push(`${text(c.slipShare * 100, 0)} % of it slips`);
    if (c.reachesBorder) said.push("reaches the border: part of it is not seen");
    if (c.skin) said.push(`force ± ${short(c.skin.forceSigmaN * perN)} ${name}, place ± ${short(c.skin.centerSigmaM * 1e3)} mm`);
    if (c.tool) said.push(...ofTool(c.tool, this.unit));
    if (c.model) said.push(...ofModel(c.model));
    const flow = c.flowParts;
    if (flow) said.push(`flow ${short(flow.curlFreeM * 1e6)} µm curl-free, ${short(flow.divergenceFreeM * 1e6)} µm divergence-free, twist ${degrees(flow.twistRad)}`);
    return said.join(" · ");
  }

  private showLearned(learned: NonNullable<SensorNews["learned"]>): void {
    const said = learned.isValid ? learned.quantities.map(([name, value]) => `${words(name)} ${value}`).join(" · ") : "invalid";
    const rate = learned.periodS > 0 ? `, ${text(1 / learned.periodS, 1)} Hz` : "";
    write(this.learned, `Network, of frame ${learned.frame}, ${text(learned.latencyS * 1e3, 0)} ms later (network ${text(learned.tookS * 1e3, 0)} ms${rate}): ${said}`);
  }

  /** A ring where to press next, millimetres; none. */
  aim(target: { x: number; y: number } | undefined): void {
    this.maps.aim(target);
    this.field.aim(target);
  }

  close(): void {
    this.field.close();
    this.element.remove();
  }
}

const KIND_WORDS = ["", "planar", "hertzian"];

function ofSqueeze(s: Softness | undefined): string {
  if (!s || s.nFrames === 0 || Number.isNaN(s.modulusPa)) return "";
  const kPa = (pa: number): string => `${short(pa * 1e-3)} kPa`;
  const range = s.highPa === Infinity ? `at least ${kPa(s.lowPa)}` : `${kPa(s.lowPa)} to ${kPa(s.highPa)}`;
  return `. Last object squeezed: ${s.modulusPa === Infinity ? "as hard as a rigid one" : kPa(s.modulusPa)}, ${range}`;
}

function ofTool(t: ToolTouch, { perN, name }: Unit): string[] {
  const [x, y, way] = t.placeM.map((place, i) => `${short(place * 1e3)} ± ${short(t.placeSigmaM[i]! * 1e3)}`);
  const said = [
    `force ± ${short(t.forceSigmaN * perN)} ${name}`,
    `roll ${degrees(t.rollRad)} ± ${degrees(t.rollSigmaRad)}, pitch ${degrees(t.pitchRad)} ± ${degrees(t.pitchSigmaRad)}`,
    `axis at ${x}, ${y} mm, ${way} mm down`,
  ];
  if (t.faceAreaSigmaM2 > 0) said.push(`area ± ${short(t.faceAreaSigmaM2 * 1e6)} mm²`);
  if (!Number.isNaN(t.flatAreaM2)) said.push(`flat ${short(t.flatAreaM2 * 1e6)} ± ${short(t.flatAreaSigmaM2 * 1e6)} mm²`);
  return said;
}

function ofModel(m: ContactModel): string[] {
  const said: string[] = [];
  if (!Number.isNaN(m.gelDepthM)) {
    said.push(`${short(m.gelDepthM * 1e3)} ± ${short(m.gelDepthSigmaM * 1e3)} mm deep, object ${short(m.pressDepthM * 1e3)} mm`);
    said.push(`effective area ${short(m.effectiveAreaM2 * 1e6)} mm²`);
  }
  if (!Number.isNaN(m.shoreA)) {
    said.push(`${m.shoreA.toFixed(0)} ± ${m.shoreASigma.toFixed(0)} Shore A, stiffness ${short(m.stiffnessPaPerM * 1e-9)} kPa/µm`);
  }
  if (m.kind) said.push(`${KIND_WORDS[m.kind] ?? "unknown kind"} (${text(m.kindConfidence * 100, 0)} %)`);
  said.push(`mean flow ${short(m.meanFlowM * 1e6)} µm, moment by flow ${short(m.momentByFlowNm * 1e3)} N mm`);
  return said;
}

function degrees(rad: number): string {
  return `${text((rad * 180) / Math.PI, 1)}°`;
}

/** One number with its unit, how sure it is, and a word where it must not be used. */
class Cell {
  readonly element: HTMLElement;
  private readonly value = make("output", {}, ABSENT);
  private readonly unit = make("span", { class: "unit" });
  private readonly note = make("span", { class: "note" });

  constructor(name: string) {
    this.element = make("div", { class: "cell", id: "" }, make("b", {}, name), this.value, this.unit, this.note);
    this.element.removeAttribute("id");
  }

  show(value: number, sigma: number, unit: string, digits: number, validity: number): void {
    write(this.value, validity === NOT_MEASURED ? ABSENT : text(value, digits));
    write(this.unit, validity === VALID ? unit : "");
    write(this.note, validity === VALID ? `± ${Number.isNaN(sigma) ? "?" : text(sigma, digits)}` : (VALIDITY_WORDS[validity] ?? "invalid"));
    this.element.dataset["validity"] = String(validity);
  }
}
