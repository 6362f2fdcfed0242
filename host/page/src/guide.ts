// What a collection is at that has this page beside it (../ruffini/rig/guide.py); read as if it came from anybody.

export interface Load {
  unit: string;
  low: number;
  high: number;
  now: number | undefined; // by the reference
  sensor: number | undefined;
}

export interface Quality {
  name: string;
  ok: boolean | undefined; // undefined: neither good nor bad
  text: string;
}

export interface Choice {
  word: string;
  label: string;
  hint: string;
}

export interface Field {
  name: string;
  label: string;
  value: string;
  unit: string;
}

export interface Gate {
  name: string;
  ok: boolean | undefined; // undefined: could not be judged
  text: string;
  remedy: string; // what to press again
}

/** Of a calibration that a person makes in this page (../ruffini/view/steps.py). */
export interface Step {
  /** Empty: nothing is shown but the button that begins it. "press": a collection goes on. */
  phase: string;
  number: number;
  text: string;
  isBad: boolean;
  part: number | undefined; // of the work that is done
  choices: Choice[];
  fields: Field[];
  gates: Gate[];
  /** Number of the report to show. */
  report: number | undefined;
}

export interface Guide {
  step: Step | undefined; // undefined: a collection of the command line
  program: string;
  said: string;
  /** Number of the question that waits for an answer; 0: none does. */
  asked: number;
  /** Its answer is a number that is typed. */
  wantsNumber: boolean;
  nDone: number;
  nTotal: number;
  nRedone: number;
  /** x, y of each touch of the plan in millimetres from the pad's centre, and whether it is kept. */
  touches: { x: number; y: number; isDone: boolean }[];
  target: { x: number; y: number } | undefined;
  load: Load | undefined;
  held: number | undefined; // part of the hold, 0 to 1
  quality: Quality[];
  setAside: string[];
  end: { isOk: boolean; text: string; next: string } | undefined;
}

const MAX_TEXT = 600;
const MAX_REASON = 2000;
const MAX_TOUCHES = 5000;
const MAX_ROWS = 32;
const MAX_COUNT = 1e6;
const MAX_MM = 1e4;
const MAX_LOAD = 1e6;

/** The newest state; undefined where it is none. */
export function readGuide(told: unknown): Guide | undefined {
  const m = table(told);
  if (!m || m["kind"] !== "guide" || typeof m["said"] !== "string") return undefined;
  return {
    program: text(m["program"]),
    said: text(m["said"]),
    asked: count(m["asked"]),
    wantsNumber: m["wants_number"] === true,
    nDone: count(m["n_done"]),
    nTotal: count(m["n_total"]),
    nRedone: count(m["n_redone"]),
    touches: list(m["touches"], MAX_TOUCHES).flatMap((t) => {
      const place = placeOf(t);
      return place ? [{ ...place, isDone: (t as unknown[])[2] === 1 }] : [];
    }),
    target: placeOf(m["target"]),
    load: loadOf(m["load"]),
    held: number(m["held"], 0, 1),
    quality: list(m["quality"], MAX_ROWS).flatMap((q) => qualityOf(q)),
    setAside: list(m["set_aside"], MAX_ROWS).flatMap((s) => (typeof s === "string" ? [text(s)] : [])),
    end: endOf(m["end"]),
    step: stepOf(m),
  };
}

function stepOf(m: Record<string, unknown>): Step | undefined {
  if (typeof m["phase"] !== "string") return undefined;
  return {
    phase: text(m["phase"]),
    number: count(m["step"]),
    text: text(m["text"], MAX_REASON),
    isBad: m["is_bad"] === true,
    part: number(m["part"], 0, 1),
    choices: rows(m["choices"]).map((c) => ({ word: text(c["word"]), label: text(c["label"]), hint: text(c["hint"]) })),
    fields: rows(m["fields"]).map((f) => ({ name: text(f["name"]), label: text(f["label"]), value: text(f["value"]), unit: text(f["unit"]) })),
    gates: rows(m["gates"]).map((g) => ({ name: text(g["name"]), ok: isTrue(g["ok"]), text: text(g["text"]), remedy: text(g["remedy"]) })),
    report: number(m["report"], 0, MAX_COUNT),
  };
}

function rows(value: unknown): Record<string, unknown>[] {
  return list(value, MAX_ROWS).flatMap((row) => {
    const found = table(row);
    return found ? [found] : [];
  });
}

function isTrue(value: unknown): boolean | undefined {
  return typeof value === "boolean" ? value : undefined;
}

/** How far the place of the plan that is furthest from any kept touch is from it, millimetres; undefined without either. */
export function largestGap(touches: Guide["touches"]): number | undefined {
  const kept = touches.filter((t) => t.isDone);
  if (!kept.length) return undefined;
  let largest = 0;
  for (const t of touches) {
    let nearest = Infinity;
    for (const k of kept) nearest = Math.min(nearest, Math.hypot(t.x - k.x, t.y - k.y));
    largest = Math.max(largest, nearest);
  }
  return largest;
}

function table(value: unknown): Record<string, unknown> | undefined {
  return typeof value === "object" && value !== null && !Array.isArray(value) ? (value as Record<string, unknown>) : undefined;
}

function list(value: unknown, most: number): unknown[] {
  return Array.isArray(value) ? value.slice(0, most) : [];
}

function text(value: unknown, most = MAX_TEXT): string {
  return typeof value === "string" ? value.slice(0, most) : "";
}

function number(value: unknown, low: number, high: number): number | undefined {
  return typeof value === "number" && value >= low && value <= high ? value : undefined;
}

function count(value: unknown): number {
  return Math.floor(number(value, 0, MAX_COUNT) ?? 0);
}

function placeOf(value: unknown): { x: number; y: number } | undefined {
  if (!Array.isArray(value)) return undefined;
  const [x, y] = [number(value[0], -MAX_MM, MAX_MM), number(value[1], -MAX_MM, MAX_MM)];
  return x === undefined || y === undefined ? undefined : { x, y };
}

function loadOf(value: unknown): Load | undefined {
  const m = table(value);
  const [low, high] = [number(m?.["low"], 0, MAX_LOAD), number(m?.["high"], 0, MAX_LOAD)];
  if (!m || low === undefined || high === undefined || !(high > low)) return undefined;
  const now = number(m["now"], -MAX_LOAD, MAX_LOAD);
  return { unit: text(m["unit"]), low, high, now, sensor: number(m["sensor"], -MAX_LOAD, MAX_LOAD) };
}

function qualityOf(value: unknown): Quality[] {
  const m = table(value);
  if (!m || typeof m["name"] !== "string") return [];
  return [{ name: text(m["name"]), ok: isTrue(m["ok"]), text: text(m["text"]) }];
}

function endOf(value: unknown): Guide["end"] {
  const m = table(value);
  return m && { isOk: m["ok"] === true, text: text(m["text"]), next: text(m["next"]) };
}
