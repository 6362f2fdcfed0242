// Flat maps as the camera sees the pad: x to the right, y down.

import type { SensorInfo } from "../board";
import { type Contacts, type Depth, type Field, type Image, NOT_MEASURED, type Residual, UNCALIBRATED, VALID } from "../results";
import { type Rgb, sequential, wheel } from "./colours";
import { make } from "./dom";
import { ABSENT, short, type Unit, VALIDITY_WORDS } from "./units";

const HATCH_PX = 10;
const NOTHING_YET = "nothing yet";
const LEAST_FULL_SIGMAS = 5; // what noise and an ordinary press make stays in the lower part of the bar
const WHEEL_ENDS = ["+x", "+y", "−x", "−y", "+x"];

/** One picture with a title, a bar of its colours and what its ends mean. */
export class PadMap {
  readonly element = document.createElement("figure");
  readonly canvas = document.createElement("canvas");
  private readonly range = document.createElement("span");
  private readonly small = document.createElement("canvas");
  private readonly bar = document.createElement("canvas");
  /** What is shown, for tests: "" until something is. */
  shown = "";
  private isAbsent = true;

  constructor(title: string, aspect: number, barOf: "sequential" | "wheel" | "none") {
    const caption = document.createElement("figcaption");
    const name = document.createElement("strong");
    name.textContent = title;
    caption.append(name, this.range);
    this.canvas.style.aspectRatio = String(aspect);
    this.canvas.setAttribute("role", "img");
    this.canvas.setAttribute("aria-label", title);
    this.element.append(caption, this.canvas);
    if (barOf !== "none") this.element.append(this.colourBar(barOf));
    if (barOf === "wheel") this.element.append(make("div", { class: "ends" }, ...WHEEL_ENDS.map((end) => make("span", {}, end))));
    this.absent(NOTHING_YET);
    new ResizeObserver(() => this.isAbsent && this.hatch()).observe(this.canvas);
  }

  private colourBar(kind: "sequential" | "wheel"): HTMLCanvasElement {
    this.bar.className = "bar";
    this.bar.width = 128;
    this.bar.height = 1;
    const context = this.bar.getContext("2d")!;
    const rgb: Rgb = [0, 0, 0];
    for (let i = 0; i < 128; i++) {
      const c = kind === "wheel" ? wheel((2 * Math.PI * i) / 127) : sequential(i / 127, rgb);
      context.fillStyle = `rgb(${c.map((v) => Math.round(255 * v)).join(" ")})`;
      context.fillRect(i, 0, 1, 1);
    }
    return this.bar;
  }

  /** Hatched, with a word in it: this is not a zero. */
  absent(word: string): void {
    if (this.shown === word) return;
    this.shown = word;
    this.range.textContent = ABSENT;
    this.element.classList.add("absent");
    this.isAbsent = true;
    this.hatch();
  }

  private hatch(): void {
    const { canvas } = this;
    this.fit();
    const context = canvas.getContext("2d")!;
    context.clearRect(0, 0, canvas.width, canvas.height);
    context.strokeStyle = "rgb(128 128 128 / 35%)";
    context.lineWidth = 1;
    context.beginPath();
    for (let x = -canvas.height; x < canvas.width; x += HATCH_PX) {
      context.moveTo(x, canvas.height);
      context.lineTo(x + canvas.height, 0);
    }
    context.stroke();
    context.fillStyle = "rgb(128 128 128)";
    context.font = "600 15px system-ui, sans-serif";
    context.textAlign = "center";
    context.fillText(this.shown, canvas.width / 2, canvas.height / 2);
  }

  /** Colours of nX x nY cells; `range` says what the ends of the bar are. */
  show(nX: number, nY: number, range: string, word: string, colourOf: (cell: number) => Rgb): void {
    this.small.width = nX;
    this.small.height = nY;
    const context = this.small.getContext("2d")!;
    const pixels = context.createImageData(nX, nY);
    for (let i = 0; i < nX * nY; i++) {
      const c = colourOf(i);
      for (let k = 0; k < 3; k++) pixels.data[4 * i + k] = 255 * c[k]!;
      pixels.data[4 * i + 3] = 255;
    }
    context.putImageData(pixels, 0, 0);
    this.paste(this.small, range, word);
  }

  showPicture(image: Image): void {
    this.small.width = image.width;
    this.small.height = image.height;
    this.small.getContext("2d")!.putImageData(new ImageData(image.rgba, image.width, image.height), 0, 0);
    this.canvas.style.aspectRatio = String(image.width / image.height);
    this.paste(this.small, `${image.width} x ${image.height} px`, "");
  }

  private paste(from: HTMLCanvasElement, range: string, word: string): void {
    this.shown = word || "values";
    this.isAbsent = false;
    this.element.classList.toggle("absent", word !== "");
    this.range.textContent = word ? `${word} · ${range}` : range;
    this.fit();
    const context = this.canvas.getContext("2d")!;
    context.imageSmoothingEnabled = true;
    context.globalAlpha = word ? 0.5 : 1;
    context.drawImage(from, 0, 0, this.canvas.width, this.canvas.height);
    context.globalAlpha = 1;
  }

  /** Rings at the contacts' places, by their part of the picture's width and height; dashed: at a place to press. */
  ring(places: [number, number][], isTarget = false): void {
    const context = this.canvas.getContext("2d")!;
    context.setLineDash(isTarget ? [6, 4] : []);
    for (const [x, y] of places) {
      for (const [colour, width] of [["#000", 4], ["#fff", 2]] as const) {
        context.strokeStyle = colour;
        context.lineWidth = width;
        context.beginPath();
        context.arc(x * this.canvas.width, y * this.canvas.height, isTarget ? 13 : 8, 0, 2 * Math.PI);
        context.stroke();
      }
    }
    context.setLineDash([]);
  }

  private fit(): void {
    const [w, h] = [this.canvas.clientWidth || 240, this.canvas.clientHeight || 180];
    if (this.canvas.width !== w) this.canvas.width = w;
    if (this.canvas.height !== h) this.canvas.height = h;
  }
}

/** All the maps of one sensor: those that its board can fill. */
export class Maps {
  readonly element = document.createElement("div");
  readonly maps: Record<string, PadMap> = {};
  private places: [number, number][] = [];
  private target: [number, number][] = [];

  constructor(private readonly info: SensorInfo) {
    this.element.className = "maps";
    const { nX, nY, stepX, stepY } = info.grid;
    const aspect = info.fieldForces ? (nX * stepX) / (nY * stepY) : info.padX / info.padY;
    const add = (name: string, title: string, bar: "sequential" | "wheel" | "none"): void => {
      this.maps[name] = new PadMap(title, aspect, bar);
      this.element.append(this.maps[name].element);
    };
    if (info.fieldForces) {
      add("normal", "Normal force", "sequential");
      add("shear", "Shear", "wheel");
      add("sigma", "Uncertainty of fz", "sequential");
    }
    if (info.stages.includes("support") && info.fieldForces) {
      add("residual", "Not explained", "sequential");
      this.hideResidual();
    }
    if (info.stages.some((stage) => stage === "poisson" || stage === "photometric")) add("depth", "Depth", "sequential");
    else if (info.fieldForces) add("depth", "Depth at the nodes", "sequential");
    add("camera", "Camera", "none");
    this.hideImage();
  }

  /** The camera's picture is not asked for. */
  hideImage(): void {
    this.maps["camera"]!.absent("press C");
    this.maps["camera"]!.element.hidden = true;
  }

  /** It is not asked for: the sensor does not find it. */
  hideResidual(): void {
    this.maps["residual"]?.absent("press E");
    if (this.maps["residual"]) this.maps["residual"].element.hidden = true;
  }

  showContacts(contacts: Contacts): void {
    this.places = contacts.contacts.map(({ center: [x, y] }) => this.partOf(x, y));
  }

  /** A ring where to press next, millimetres; none. Drawn with the next field. */
  aim(target: { x: number; y: number } | undefined): void {
    this.target = target ? [this.partOf(1e-3 * target.x, 1e-3 * target.y)] : [];
  }

  /** A place on the pad by its part of the map's width and height. */
  private partOf(x: number, y: number): [number, number] {
    const { grid, padX, padY, fieldForces } = this.info;
    const [x0, y0] = fieldForces ? [grid.originX, grid.originY] : [-padX / 2, -padY / 2];
    const [w, h] = fieldForces ? [(grid.nX - 1) * grid.stepX, (grid.nY - 1) * grid.stepY] : [padX, padY];
    return [(x - x0) / w, (y - y0) / h];
  }

  showField(field: Field, unit: Unit): void {
    if (field.nX < 2 || !this.maps["normal"]) return;
    this.normal(field, unit);
    this.shear(field, unit);
    this.sigma(field, unit);
    if (!this.info.stages.includes("poisson")) this.nodeDepth(field);
    this.maps["normal"].ring(this.places);
    this.maps["normal"].ring(this.target, true);
  }

  private normal(field: Field, unit: Unit): void {
    const validity = field.validity[2]!;
    if (validity === NOT_MEASURED) return this.maps["normal"]!.absent(VALIDITY_WORDS[NOT_MEASURED]!);
    let most = 0;
    for (let i = 2; i < field.force.length; i += 3) most = Math.max(most, -field.force[i]!);
    const full = Math.max(most, 1e-4);
    const rgb: Rgb = [0, 0, 0];
    const range = `0 … ${short(full * unit.perN * 1e3)} m${unit.name}`;
    this.maps["normal"]!.show(field.nX, field.nY, range, wordOf(validity), (i) => sequential(-field.force[3 * i + 2]! / full, rgb));
  }

  private shear(field: Field, unit: Unit): void {
    const validity = Math.max(field.validity[0]!, field.validity[1]!);
    if (Math.min(field.validity[0]!, field.validity[1]!) === NOT_MEASURED) {
      return this.maps["shear"]!.absent(VALIDITY_WORDS[NOT_MEASURED]!);
    }
    let most = 1e-4;
    for (let i = 0; i < field.force.length; i += 3) most = Math.max(most, Math.hypot(field.force[i]!, field.force[i + 1]!));
    const out: Rgb = [0, 0, 0];
    const range = `0 … ${short(most * unit.perN * 1e3)} m${unit.name}`;
    this.maps["shear"]!.show(field.nX, field.nY, range, wordOf(validity), (i) => {
      const [fx, fy] = [field.force[3 * i]!, field.force[3 * i + 1]!];
      const hue = wheel(Math.atan2(fy, fx));
      const share = Math.hypot(fx, fy) / most;
      for (let k = 0; k < 3; k++) out[k] = 0.12 + (hue[k]! - 0.12) * share;
      return out;
    });
  }

  private sigma(field: Field, unit: Unit): void {
    const { sigma } = field;
    if (!sigma) return this.maps["sigma"]!.absent(VALIDITY_WORDS[NOT_MEASURED]!);
    let [least, most] = [Infinity, 0];
    for (let i = 2; i < sigma.length; i += 3) {
      least = Math.min(least, sigma[i]!);
      most = Math.max(most, sigma[i]!);
    }
    const rgb: Rgb = [0, 0, 0];
    const range = `± ${short(least * unit.perN * 1e3)} … ${short(most * unit.perN * 1e3)} m${unit.name}`;
    this.maps["sigma"]!.show(field.nX, field.nY, range, "", (i) =>
      sequential((sigma[3 * i + 2]! - least) / Math.max(most - least, 1e-9), rgb),
    );
  }

  private nodeDepth(field: Field): void {
    const u = field.displacement;
    if (!u) return this.maps["depth"]!.absent(VALIDITY_WORDS[NOT_MEASURED]!);
    this.depthOf(field.nX, field.nY, field.validity[2] === VALID ? "" : wordOf(UNCALIBRATED), (i) => u[3 * i + 2]!);
  }

  showDepth(depth: Depth): void {
    const map = this.maps["depth"];
    if (!map || depth.nX < 2) return;
    if (depth.validity === NOT_MEASURED) return map.absent(VALIDITY_WORDS[NOT_MEASURED]!);
    map.canvas.style.aspectRatio = String(depth.nX / depth.nY);
    this.depthOf(depth.nX, depth.nY, wordOf(depth.validity), (i) => depth.depth[i]!);
  }

  private depthOf(nX: number, nY: number, word: string, depthAt: (cell: number) => number): void {
    let deepest = 1e-5;
    for (let i = 0; i < nX * nY; i++) deepest = Math.max(deepest, -depthAt(i));
    const rgb: Rgb = [0, 0, 0];
    this.maps["depth"]!.show(nX, nY, `0 … ${short(deepest * 1e3)} mm`, word, (i) => sequential(-depthAt(i) / deepest, rgb));
  }

  showResidual(residual: Residual): void {
    const map = this.maps["residual"];
    if (!map) return;
    map.element.hidden = false;
    if (residual.nX < 2) return map.absent(VALIDITY_WORDS[NOT_MEASURED]!);
    const full = residual.size.reduce((a, b) => Math.max(a, b), LEAST_FULL_SIGMAS);
    const rgb: Rgb = [0, 0, 0];
    map.show(residual.nX, residual.nY, `0 … ${short(full)} σ`, wordOf(residual.validity), (i) => sequential(residual.size[i]! / full, rgb));
    map.ring(this.places);
  }

  showImage(image: Image): void {
    this.maps["camera"]!.element.hidden = false;
    this.maps["camera"]!.showPicture(image);
  }
}

function wordOf(validity: number): string {
  return VALIDITY_WORDS[validity] ?? "invalid";
}
