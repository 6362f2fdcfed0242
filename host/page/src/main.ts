// The page: lines, panels, keys.

import type { Guide } from "./guide";
import { pressKey } from "./keys";
import { Line } from "./line";
import type { Answer, Hello, Snapshot } from "./messages";
import type { Field } from "./results";
import { save, screenshot } from "./screenshot";
import { NO_SERIAL, serialOf, SerialSource } from "./serial";
import { button, make } from "./views/dom";
import type { Tint } from "./views/field3d";
import { FlashDialog } from "./views/flash_dialog";
import { type AnswerTo, type Choose, GuidePanel } from "./views/guide_panel";
import { Health } from "./views/health";
import { Panel } from "./views/panel";
import { Rates } from "./views/rates";
import { UNITS } from "./views/units";

const TINTS: Tint[] = ["normal", "slip", "plain"];
const READ_MS = 4000; // a sentence stays at least so long
const SEVERITY_WARNING = 1;
const NOTHING_TO_DO = new Set(["camera_back", "calibration_active"]); // news that goes again by itself

type News = Snapshot["events"][number];

/** One line with the panels of its sensors. */
interface Strand {
  line: Line;
  id: number; // of the viewer's server
  serial: SerialSource | undefined; // that the page has opened itself
  panels: Map<number, Panel>;
  health: Health;
  guide: GuidePanel | undefined; // where a collection goes on with its sensor
  hello: Hello | undefined;
  waiting: Snapshot | undefined; // comes on the screen with the next frame of it
  latest: Partial<Snapshot>; // that was shown
  nDrawn: number;
  openedMs: number | undefined; // when its line was opened
  firstFrameMs: number | undefined; // from then to the first results on the screen
}

const strands: Strand[] = [];
const flashDialog = new FlashDialog();
const main = document.querySelector("main")!;
const notice = document.querySelector<HTMLElement>("#notice")!;
const motion = matchMedia("(prefers-reduced-motion: reduce)");
motion.addEventListener("change", () => panels().forEach((panel) => panel.field.setStill(motion.matches)));
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => paint());
let unit = 0;
let tint = 0;
let isFrozen = false;
const rates = new Rates(subscribe);
let isLocked = false;
let isRecording = false;
let isFile = false; // a recording is shown
let closing: Promise<unknown> = Promise.resolve(); // of lines that were shown before
let answeredMs = -Infinity; // a person was answered: news waits until that is read
let news: News | undefined; // the newest that waits: good news may take back a bad one
let passesMs = Infinity; // when the notice goes by itself
let isZeroRefused = false; // and the notice says so: Zero again means it

function say(text: string, isBad = false, isWarning = false): void {
  isZeroRefused = false;
  passesMs = Infinity;
  notice.textContent = text;
  notice.classList.toggle("bad", isBad);
  notice.classList.toggle("warn", isWarning);
  notice.hidden = !text;
}

/** What comes of what a person asked for. */
function answer(text: string, isBad: boolean): void {
  say(text, isBad);
  answeredMs = performance.now();
  publish();
}

function tellNews(events: News[]): void {
  const nowMs = performance.now();
  if (nowMs > passesMs) say("");
  news = events.at(-1) ?? news;
  if (!news || nowMs < answeredMs + READ_MS) return;
  say(news.text || news.what, news.severity > SEVERITY_WARNING, news.severity === SEVERITY_WARNING);
  if (NOTHING_TO_DO.has(news.what) && news.severity <= SEVERITY_WARNING) passesMs = nowMs + READ_MS;
  news = undefined;
}

function addStrand(id = 0): Strand {
  const health = new Health();
  const strand: Strand = { line: undefined as unknown as Line, id, serial: undefined, panels: new Map(), health, guide: undefined, hello: undefined, waiting: undefined, latest: {}, nDrawn: 0, openedMs: undefined, firstFrameMs: undefined };
  strand.line = new Line({
    onHello: (hello) => greet(strand, hello),
    onSnapshot: (snapshot) => {
      strand.waiting = snapshot;
    },
    onGuide: (guide) => showGuide(strand, guide),
    onFlashing: (part, text, isOver, isOk) => {
      flashDialog.show(part, text, isOk);
      if (isOver) flashDialog.end();
    },
    onRecorded: (blob, nMessages) => {
      isRecording = false;
      document.body.classList.remove("recording");
      save(blob, "mcap");
      say(`Recorded ${nMessages} messages, ${(blob.size / 1e6).toFixed(1)} MB.`);
      publish();
    },
    onOpen: () => (strand.openedMs ??= performance.now()),
    onProblem: (text) => {
      say(text, true);
      for (const panel of strand.panels.values()) panel.element.classList.toggle("lost", text !== "");
      publish();
    },
  });
  strand.line.tell({ kind: "subscribe", every: rates.subscription });
  strands.push(strand);
  return strand;
}

function greet(strand: Strand, hello: Hello): void {
  strand.hello = hello;
  // Who comes back as it was keeps its charts and its scale.
  const isSame = hello.sensors.every((info) => JSON.stringify(strand.panels.get(info.sensor)?.info) === JSON.stringify(info));
  if (!isSame || strand.panels.size !== hello.sensors.length) {
    for (const panel of strand.panels.values()) panel.close();
    strand.panels.clear();
    for (const info of hello.sensors) {
      const panel = new Panel(info, UNITS[unit]!, motion.matches);
      panel.setTint(TINTS[tint]!);
      strand.panels.set(info.sensor, panel);
      main.append(panel.element);
    }
    main.append(strand.health.element);
  }
  for (const panel of strand.panels.values()) panel.element.classList.remove("lost");
  main.dataset["lines"] = String(strands.length);
  main.dataset["panels"] = String(document.querySelectorAll("section.sensor").length);
  const names = strands.flatMap((s) => (s.hello ? [`${s.hello.sensors.map((i) => i.board).join(" + ")} ${s.hello.serial}`] : []));
  document.querySelector("#who")!.textContent = names.join(" · ");
  document.title = `ruffini: ${names.join(", ")}`;
  paint();
  publish();
}

function showGuide(strand: Strand, guide: Guide): void {
  if (!strand.guide) {
    const answer: AnswerTo = (word, typed) => strand.line.tell({ kind: "answer", word, asked: panel.latest?.asked ?? 0, typed });
    const choose: Choose = (word, step, fields) => strand.line.tell({ kind: "choose", word, step, fields });
    const panel = new GuidePanel(answer, choose, `report/${strand.id}`);
    strand.guide = panel;
    main.prepend(panel.element);
  }
  const first = [...strand.panels.values()][0];
  strand.guide.show(guide, first?.info);
  first?.aim(guide.end ? undefined : guide.target);
  calibrateButton.hidden = !strands.some((s) => s.guide?.latest?.step);
  publish();
}

function draw(nowMs: number): void {
  requestAnimationFrame(draw);
  for (const strand of strands) {
    if (strand.waiting && !isFrozen) {
      show(strand, strand.waiting);
      strand.waiting = undefined;
      strand.line.tell({ kind: "shown" });
    }
    for (const panel of strand.panels.values()) panel.draw(nowMs);
    strand.health.tables.tick(nowMs);
  }
}

function show(strand: Strand, snapshot: Snapshot): void {
  for (const [id, news] of snapshot.sensors) {
    if (!rates.wants("image")) delete news.image; // asked for by another page
    if (!rates.wants("residual")) delete news.residual; // likewise
    strand.panels.get(id)?.show(news);
  }
  if (snapshot.status) strand.health.showStatus(snapshot.status, [...strand.panels.values()].flatMap((panel) => panel.info.stages));
  strand.health.keep(snapshot.health);
  strand.latest.health = snapshot.health;
  if (snapshot.status) strand.latest.status = snapshot.status;
  tellNews(snapshot.events);
  strand.nDrawn++;
  if (snapshot.sensors.length) strand.firstFrameMs ??= performance.now() - (strand.openedMs ?? 0);
  publish();
}

/** What tests read: numbers as they are shown, not pixels; worked out when they are read. */
function publish(): void {
  Object.assign(window, {
    __state: {
      notice: notice.textContent,
      get lines() {
        return strands.map(stateOf);
      },
    },
  });
}

function stateOf(strand: Strand): object {
  const { line, hello, nDrawn, firstFrameMs, guide, latest, panels } = strand;
  return {
    port: line.port,
    serial: hello?.serial,
    firmware: hello?.firmware,
    nDrawn,
    firstFrameMs,
    guide: guide?.latest,
    health: latest.health,
    status: latest.status,
    get sensors() {
      return Object.fromEntries([...panels].map(([id, panel]) => [id, stateOfPanel(panel)]));
    },
  };
}

function stateOfPanel({ info, latest, maps, charts, field }: Panel): object {
  const { depth, residual } = latest;
  return {
    board: info.board,
    calibration: info.calibration,
    flags: latest.flags,
    isSimulated: latest.isSimulated,
    isReplay: latest.isReplay,
    wrench: latest.wrench,
    contacts: latest.contacts?.contacts,
    field: latest.field && stateOfField(latest.field),
    depth: depth && { frame: depth.frame, deepest: depth.depth.reduce((a, b) => Math.min(a, b), 0) },
    maps: Object.fromEntries(Object.entries(maps.maps).map(([name, map]) => [name, map.shown])),
    residual: residual && { frame: residual.frame, nX: residual.nX, validity: residual.validity, ...mostOf(residual.size) },
    nArrows: field.nArrows,
    seenFrom: field.seenFrom,
    nChartPoints: charts.nPoints,
  };
}

function stateOfField({ frame, nX, nY, force, sigma }: Field): object {
  return { frame, nX, nY, sum: sums(force), hasSigma: Boolean(sigma) };
}

function mostOf(values: Float32Array): { most: number; at: number } {
  const at = values.reduce((best, v, i) => (v > values[best]! ? i : best), 0);
  return { most: values[at] ?? NaN, at };
}

function sums(force: Float32Array): number[] {
  const out = [0, 0, 0];
  force.forEach((f, i) => (out[i % 3]! += f));
  return out;
}

// ---- what a person can do -------------------------------------------------------------------------

/** What a page cannot do: it has no key to sign with. */
function onlyOwners(keys: string[]): string {
  return `This sensor is changed by its owners only (${keys.length > 1 ? "keys" : "key"} ${keys.join(", ")}), and a page holds no key. On a computer that has one of them`;
}

/** A sensor refuses while something presses; asked again, that becomes part of rest. */
function zero(): void {
  const locked = strands.find(({ hello }) => hello?.ownersKeys.length);
  if (locked) return answer(`${onlyOwners(locked.hello!.ownersKeys)}: \`ruffini cal zero\`.`, true);
  const evenIfTouched = isZeroRefused;
  say(`Learning the rest image: ${evenIfTouched ? "with what presses on the pad" : "keep everything off the pad"}.`);
  void Promise.all(strands.map(({ line }) => line.command("zero", { nFrames: 0, evenIfTouched }))).then((answers) => {
    tellAnswers(answers);
    isZeroRefused = answers.some((answer) => answer.isRefused);
    if (!isZeroRefused) return;
    notice.textContent += ". Press Zero once more to learn it with what presses.";
    publish();
  });
}

function tellAnswers(answers: Answer[]): void {
  const refused = answers.find((a) => !a.isOk);
  answer(refused ? refused.text : (answers[0]?.text ?? ""), Boolean(refused));
}

function freeze(): void {
  isFrozen = !isFrozen;
  if (isFrozen) for (const panel of panels()) panel.texts.flush(); // of the field beside them
  document.body.classList.toggle("frozen", isFrozen);
  say(isFrozen ? "Frozen: the sensor goes on. Press space to go on." : "");
}

function record(): void {
  if (isFile) return answer("Nothing to record: this is a recording. Press Live first.", true);
  if (!strands.some((strand) => strand.hello)) return say("Nothing to record: no sensor is connected.", true);
  isRecording = !isRecording;
  document.body.classList.toggle("recording", isRecording);
  for (const { line } of strands) line.tell({ kind: "record", isOn: isRecording });
  if (isRecording) say("Recording. Press R again to save it.");
}

const calibrations = document.querySelector<HTMLInputElement>("#calibration")!;
calibrations.addEventListener("change", () => {
  const file = calibrations.files?.[0];
  calibrations.value = "";
  if (file) askToFlash(file);
});

function askToFlash(file: File): void {
  const [strand, other] = strands.filter(({ hello }) => hello);
  if (!strand) return say("No sensor is connected.", true);
  if (other) return say("Several sensors are shown: flash them one at a time, each in a viewer of its own.", true);
  const { serial, sensors, ownersKeys } = strand.hello!;
  if (ownersKeys.length) return flashDialog.refuse(`${onlyOwners(ownersKeys)}: \`ruffini cal flash ${file.name} --key NAME\`.`);
  const { isPresent, createdUtc } = sensors[0]!.calibration;
  const before = isPresent ? `It takes the place of the calibration of ${createdUtc || "an unknown day"}, which the sensor keeps.` : "The sensor has no calibration yet.";
  const what = `${file.name}, ${(file.size / 1e6).toFixed(2)} MB, onto ${sensors[0]!.board} ${serial}. ${before}`;
  flashDialog.ask(what, () => strand.line.tell({ kind: "flash", file }));
}

/** The first step; while one is shown the panel is what goes on. */
function calibrate(): void {
  const [strand, other] = strands.filter(({ guide }) => guide?.latest?.step);
  if (other) return say("Several sensors are shown: calibrate them one at a time, each in a viewer of its own.", true);
  if (strand?.guide?.latest?.step?.phase === "") strand.guide.choose("open");
  else strand?.guide?.element.scrollIntoView();
}

/** Nothing is shown any more; a recording that was under way is saved. */
function closeLines(): void {
  const gone = strands.splice(0);
  for (const strand of gone) {
    for (const panel of strand.panels.values()) panel.close();
    strand.health.element.remove();
    strand.guide?.element.remove();
  }
  calibrateButton.hidden = true;
  closing = Promise.all(gone.map(({ line, serial }) => line.close().then(() => serial?.close())));
  document.querySelector("#who")!.textContent = "";
}

/** Show a recording instead of what is there. */
function openFile(file: File): void {
  closeLines();
  showAsFile(true);
  if (!isRecording) say("");
  addStrand().line.tell({ kind: "file", file });
}

function showAsFile(isOne: boolean): void {
  isFile = isOne;
  live.hidden = !isOne;
}

/** Back from a recording. */
function goLive(): void {
  closeLines();
  showAsFile(false);
  void start();
}

const chooser = document.querySelector<HTMLInputElement>("#file")!;
chooser.addEventListener("change", () => {
  const file = chooser.files?.[0];
  if (file) openFile(file);
  chooser.value = ""; // the same one may be chosen again
});

function nextUnit(): void {
  unit = (unit + 1) % UNITS.length;
  for (const panel of panels()) panel.setUnit(UNITS[unit]!);
}

function nextTint(): void {
  tint = (tint + 1) % TINTS.length;
  for (const panel of panels()) panel.setTint(TINTS[tint]!);
}

function lockScale(): void {
  isLocked = !isLocked;
  for (const panel of panels()) panel.field.isScaleLocked = isLocked;
}

function subscribe(): void {
  for (const { line } of strands) line.tell({ kind: "subscribe", every: rates.subscription });
  if (!rates.wants("image")) for (const panel of panels()) panel.maps.hideImage();
  if (!rates.wants("residual")) for (const panel of panels()) panel.maps.hideResidual();
}

function toggleTheme(): void {
  const root = document.documentElement;
  root.dataset["theme"] = isDark() ? "light" : "dark";
  paint();
}

function isDark(): boolean {
  return getComputedStyle(document.documentElement).getPropertyValue("color-scheme") === "dark";
}

/** Canvases know nothing of style sheets. */
function paint(): void {
  const background = getComputedStyle(document.documentElement).getPropertyValue("--stage").trim();
  for (const panel of panels()) {
    panel.field.setBackground(background);
    panel.charts.rebuild(UNITS[unit]!);
  }
}

function panels(): Panel[] {
  return strands.flatMap((strand) => [...strand.panels.values()]);
}

function help(): void {
  document.querySelector<HTMLDialogElement>("#help")!.showModal();
}

const live = button("Live", "B", "back from a recording to the sensors", goLive);
live.hidden = true;
const calibrateButton = button("Calibrate", "N", "newtons: calibrate this sensor with a kitchen scale", calibrate);
calibrateButton.hidden = true; // until the viewer says that it can
const BUTTONS = [
  live,
  calibrateButton,
  button("Connect", "K", "open a sensor's serial port from this page (WebSerial)", () => void connect()),
  button("Zero", "Z", "learn the untouched pad again", zero),
  button("Freeze", " ", "hold the picture (space)", freeze),
  button("Scale", "L", "lock the length of the arrows", lockScale),
  button("Tint", "I", "colour the surface by normal force, by slip, not at all", nextTint),
  button("Units", "U", "newtons, millinewtons, grams of force", nextUnit),
  button("Camera", "C", "show the camera's picture", () => rates.toggle("image")),
  button("Residual", "E", "show where the forces do not explain what the camera sees", () => rates.toggle("residual")),
  button("Rates", "M", "how often each result is asked for", () => rates.open()),
  button("View", "V", "look from where you looked at first", () => panels().forEach((panel) => panel.field.reset())),
  button("Record", "R", "record to an MCAP file, until pressed again", record),
  button("Open", "O", "show a recording (MCAP); or drop it on the page", () => chooser.click()),
  button("Flash", "F", "put a calibration file onto the sensor; asks before it does", () => calibrations.click()),
  button("Screenshot", "S", "save what is shown as a PNG", () => void screenshot(main)),
  button("Theme", "T", "dark or light", toggleTheme),
  button("Help", "?", "what the keys do", help),
];

document.querySelector("nav")!.append(...BUTTONS);
document.querySelector("#keys")!.append(
  ...BUTTONS.flatMap((b) => [make("dt", {}, make("kbd", {}, b.dataset["key"] === " " ? "space" : b.dataset["key"]!)), make("dd", {}, b.title.replace(/ \(key.*/, ""))]),
);
document.addEventListener("keydown", (event) => {
  if (event.ctrlKey || event.metaKey || event.altKey || document.querySelector("dialog[open]")) return;
  pressKey(event, [...strands.flatMap(({ guide }) => guide?.buttons ?? []), ...BUTTONS]);
});

// What is recorded is in this page's memory until it is saved.
addEventListener("beforeunload", (event) => {
  if (isRecording) event.preventDefault();
});

document.addEventListener("dragover", (event) => event.preventDefault());
document.addEventListener("drop", (event) => {
  event.preventDefault();
  const file = event.dataTransfer?.files[0];
  if (file) openFile(file);
});

/** Open a sensor without the viewer's server. */
async function connect(): Promise<void> {
  const serial = serialOf(navigator);
  if (!serial) return say(NO_SERIAL, true);
  let port;
  try {
    port = await serial.requestPort();
  } catch {
    return; // the person chose none
  }
  await closing;
  if (strands.some((strand) => strand.serial?.port === port)) return answer("This port is connected already.", true);
  const source = new SerialSource(port, await schema, serial, (text) => say(text, true));
  const problem = await source.open();
  if (problem) {
    await source.close();
    return answer(problem, true);
  }
  if (isFile) {
    closeLines();
    showAsFile(false);
  }
  const strand = addStrand();
  strand.serial = source;
  source.lead(strand.line);
}

async function fetchSchema(): Promise<Uint8Array> {
  return new Uint8Array(await (await fetch("ruffini.desc")).arrayBuffer());
}

/** The lines that the viewer's server has; none where the page comes from elsewhere. */
async function fetchLines(): Promise<{ id: number }[]> {
  const answer = await fetch("lines.json");
  return answer.ok ? ((await answer.json()) as { id: number }[]) : [];
}

async function start(): Promise<void> {
  say("Connecting ...");
  for (const { id } of await fetchLines()) {
    const url = new URL(`line/${id}`, location.href);
    url.protocol = url.protocol.replace("http", "ws");
    addStrand(id).line.tell({ kind: "websocket", url: url.href, schema: await schema });
  }
  if (!strands.length) say(serialOf(navigator) ? "Press Connect and choose the sensor's port." : NO_SERIAL);
  publish();
}

const schema = fetchSchema();
start().catch((error: unknown) => say(`The page cannot be loaded as a whole: ${String(error)}`, true));
requestAnimationFrame(draw);
