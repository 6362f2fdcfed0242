// Flat maps as the camera sees the pad: x to the right, y down.

import type { SensorInfo } from "../board";
import { type Contacts, type Depth, type Field, type Image, NOT_MEASURED, type Residual, UNCALIBRATED, VALID } from "../results";
import { type Rgb, sequential, sequentialPixel, wheel, wheelPixel } from "./colours";
import { make, write } from "./dom";
import { ABSENT, short, type Unit, VALIDITY_WORDS } from "./units";

const HATCH_PX = 10;
const ARROW_PX = 26; // of the canvas, at least, between two
const FAINT_ARROW = 0.12; // of the longest: shorter ones are not drawn
const HEAD = 0.3; // of an arrow's length
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
  private rangeOf = (): string => ABSENT;
  private pixels = new ImageData(1, 1);
  private cells = new Uint32Array(1); // the same memory

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
    // To ask the canvas for its size when it is drawn would have the browser lay out the page for each map of each field.
    new ResizeObserver(([entry]) => this.fit(entry!.contentRect)).observe(this.canvas);
  }

  private fit({ width, height }: DOMRectReadOnly): void {
    if (!width || !height) return; // hidden
    this.canvas.width = Math.round(width);
    this.canvas.height = Math.round(height);
    if (this.isAbsent) this.hatch();
    else this.stretch();
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
    this.rangeOf = () => ABSENT;
    this.writeRange();
    this.element.classList.add("absent");
    this.isAbsent = true;
    this.hatch();
  }

  private hatch(): void {
    const { canvas } = this;
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

  /** Pixels of nX x nY cells; `rangeOf` says what the ends of the bar are. */
  show(nX: number, nY: number, rangeOf: () => string, word: string, pixelOf: (cell: number) => number): void {
    if (this.pixels.width !== nX || this.pixels.height !== nY) {
      this.pixels = new ImageData(nX, nY);
      this.cells = new Uint32Array(this.pixels.data.buffer);
    }
    for (let i = 0; i < nX * nY; i++) this.cells[i] = pixelOf(i);
    this.paste(this.pixels, rangeOf, word);
  }

  showPicture(image: Image): void {
    this.canvas.style.aspectRatio = String(image.width / image.height);
    this.paste(new ImageData(image.rgba, image.width, image.height), () => `${image.width} x ${image.height} px`, "");
  }

  private paste(from: ImageData, rangeOf: () => string, word: string): void {
    const shown = word || "values";
    if (this.shown !== shown) this.element.classList.toggle("absent", word !== "");
    this.shown = shown;
    this.isAbsent = false;
    this.rangeOf = () => (word ? `${word} · ${rangeOf()}` : rangeOf());
    if (this.small.width !== from.width) this.small.width = from.width;
    if (this.small.height !== from.height) this.small.height = from.height;
    this.small.getContext("2d")!.putImageData(from, 0, 0);
    this.stretch();
  }

  private stretch(): void {
    const { canvas, shown } = this;
    const context = canvas.getContext("2d")!;
    context.globalAlpha = shown === "values" ? 1 : 0.5;
    if (shown !== "values") context.clearRect(0, 0, canvas.width, canvas.height);
    context.drawImage(this.small, 0, 0, canvas.width, canvas.height);
    context.globalAlpha = 1;
  }

  writeRange(): void {
    write(this.range, this.rangeOf());
  }

  /** What the colours of directions say, without colour: an arrow at every so many nodes, `of` a node 0 to 1 long. */
  arrows(nX: number, nY: number, of: (node: number) => [number, number]): void {
    const { canvas } = this;
    const context = canvas.getContext("2d")!;
    const [stepX, stepY] = [canvas.width / nX, canvas.height / nY];
    const every = Math.max(1, Math.ceil(ARROW_PX / Math.min(stepX, stepY)));
    const longest = 0.9 * every * Math.min(stepX, stepY);
    context.beginPath();
    for (let y = every >> 1; y < nY; y += every) {
      for (let x = every >> 1; x < nX; x += every) {
        const [dx, dy] = of(y * nX + x);
        if (Math.hypot(dx, dy) < FAINT_ARROW) continue;
        const [px, py] = [(x + 0.5) * stepX, (y + 0.5) * stepY];
        const [tipX, tipY] = [px + (dx * longest) / 2, py + (dy * longest) / 2];
        context.moveTo(px - (dx * longest) / 2, py - (dy * longest) / 2);
        context.lineTo(tipX, tipY);
        for (const side of [-1, 1]) {
          context.moveTo(tipX, tipY);
          context.lineTo(tipX - (dx - 0.6 * side * dy) * HEAD * longest, tipY - (dy + 0.6 * side * dx) * HEAD * longest);
        }
      }
    }
    for (const [colour, width] of [["#000", 3], ["#fff", 1.5]] as const) {
      context.strokeStyle = colour;
      context.lineWidth = width;
      context.stroke();
    }
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
}

/** All the maps of one sensor: those that its board can fill. */
export class Maps {
  readonly element = document.createElement("div");
  readonly maps: Record<string, PadMap> = {};
  private places: [number, number][] = [];
  private target: [number, number][] = [];

  constructor(
    private readonly info: SensorInfo,
    private unit: Unit,
  ) {
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

  /** What is written with `writeRanges`. */
  setUnit(unit: Unit): void {
    this.unit = unit;
  }

  writeRanges(): void {
    for (const map of Object.values(this.maps)) map.writeRange();
  }

  /** A node's force in the person's unit. */
  private ofNode(newtons: number): string {
    return short(newtons * this.unit.nodePerN);
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

  showField(field: Field): void {
    if (field.nX < 2 || !this.maps["normal"]) return;
    this.normal(field);
    this.shear(field);
    this.sigma(field);
    if (!this.info.stages.includes("poisson")) this.nodeDepth(field);
    this.maps["normal"].ring(this.places);
    this.maps["normal"].ring(this.target, true);
  }

  private normal(field: Field): void {
    const validity = field.validity[2]!;
    if (validity === NOT_MEASURED) return this.maps["normal"]!.absent(VALIDITY_WORDS[NOT_MEASURED]!);
    let most = 0;
    for (let i = 2; i < field.force.length; i += 3) most = Math.max(most, -field.force[i]!);
    const full = Math.max(most, 1e-4);
    const rangeOf = (): string => `0 … ${this.ofNode(full)} ${this.unit.nodeName}`;
    this.maps["normal"]!.show(field.nX, field.nY, rangeOf, wordOf(validity), (i) => sequentialPixel(-field.force[3 * i + 2]! / full));
  }

  private shear(field: Field): void {
    const validity = Math.max(field.validity[0]!, field.validity[1]!);
    if (Math.min(field.validity[0]!, field.validity[1]!) === NOT_MEASURED) {
      return this.maps["shear"]!.absent(VALIDITY_WORDS[NOT_MEASURED]!);
    }
    let most = 1e-4;
    for (let i = 0; i < field.force.length; i += 3) most = Math.max(most, Math.hypot(field.force[i]!, field.force[i + 1]!));
    const rangeOf = (): string => `0 … ${this.ofNode(most)} ${this.unit.nodeName}`;
    this.maps["shear"]!.show(field.nX, field.nY, rangeOf, wordOf(validity), (i) => {
      const [fx, fy] = [field.force[3 * i]!, field.force[3 * i + 1]!];
      return wheelPixel(Math.atan2(fy, fx), Math.hypot(fx, fy) / most);
    });
    this.maps["shear"]!.arrows(field.nX, field.nY, (i) => [field.force[3 * i]! / most, field.force[3 * i + 1]! / most]);
  }

  private sigma(field: Field): void {
    const { sigma } = field;
    if (!sigma) return this.maps["sigma"]!.absent(VALIDITY_WORDS[NOT_MEASURED]!);
    let [least, most] = [Infinity, 0];
    for (let i = 2; i < sigma.length; i += 3) {
      least = Math.min(least, sigma[i]!);
      most = Math.max(most, sigma[i]!);
    }
    const rangeOf = (): string => `± ${this.ofNode(least)} … ${this.ofNode(most)} ${this.unit.nodeName}`;
    const span = Math.max(most - least, 1e-9);
    this.maps["sigma"]!.show(field.nX, field.nY, rangeOf, "", (i) => sequentialPixel((sigma[3 * i + 2]! - least) / span));
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
    this.maps["depth"]!.show(nX, nY, () => `0 … ${short(deepest * 1e3)} mm`, word, (i) => sequentialPixel(-depthAt(i) / deepest));
  }

  showResidual(residual: Residual): void {
    const map = this.maps["residual"];
    if (!map) return;
    map.element.hidden = false;
    if (residual.nX < 2) return map.absent(VALIDITY_WORDS[NOT_MEASURED]!);
    const full = residual.size.reduce((a, b) => Math.max(a, b), LEAST_FULL_SIGMAS);
    map.show(residual.nX, residual.nY, () => `0 … ${short(full)} σ`, wordOf(residual.validity), (i) => sequentialPixel(residual.size[i]! / full));
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
