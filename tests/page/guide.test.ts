// What a collection says to the page, and what anybody else might say in its place.

import { type Guide, largestGap, readGuide } from "../../host/page/src/guide";
import { randomNumbers } from "./golden";

const GOOD = {
  kind: "guide",
  program: "free on gelslim",
  said: "harder",
  asked: 3,
  n_done: 1,
  n_total: 2,
  n_redone: 1,
  touches: [[1.5, -2, 1], [0, 3, 0]],
  target: [0, 3],
  load: { unit: "N", low: 0.85, high: 1.15, now: 0.4, sensor: null },
  held: 0.25,
  quality: [{ name: "flags", ok: true, text: "none" }, { name: "stillness", ok: null, text: "not known" }],
  set_aside: ["press by hand: no frame for 1 s"],
  end: null,
};

function read(changes: object = {}): Guide {
  return readGuide({ ...GOOD, ...changes })!;
}

test("a state is read as it was said", () => {
  expect(read()).toEqual({
    program: "free on gelslim",
    said: "harder",
    asked: 3,
    wantsNumber: false,
    nDone: 1,
    nTotal: 2,
    nRedone: 1,
    touches: [{ x: 1.5, y: -2, isDone: true }, { x: 0, y: 3, isDone: false }],
    target: { x: 0, y: 3 },
    load: { unit: "N", low: 0.85, high: 1.15, now: 0.4, sensor: undefined },
    held: 0.25,
    quality: [{ name: "flags", ok: true, text: "none" }, { name: "stillness", ok: undefined, text: "not known" }],
    setAside: ["press by hand: no frame for 1 s"],
    end: undefined,
  });
  expect(read({ wants_number: true }).wantsNumber).toBe(true);
  expect(read({ end: { ok: true, text: "All.", next: "ruffini cal fit" } }).end).toEqual({ isOk: true, text: "All.", next: "ruffini cal fit" });
});

test.each([undefined, null, 1, "guide", [], [GOOD], {}, { kind: "line" }, { ...GOOD, kind: "health" }, { ...GOOD, said: 7 }])("%j is no state", (told) => {
  expect(readGuide(told)).toBeUndefined();
});

test("what is no number, no place and no text is left out, and never shown as one", () => {
  const guide = read({
    program: { toString: () => "x" },
    asked: -1,
    wants_number: "yes",
    n_done: NaN,
    n_total: "7",
    n_redone: 1e300,
    touches: [[1], [NaN, 2, 1], ["1", "2", 1], null, [1, 2, "yes"], { 0: 1, 1: 2 }],
    target: [Infinity, 0],
    load: { unit: 3, low: 2, high: 1 },
    held: 7,
    quality: [{ ok: true }, "good", { name: "a", ok: "yes", text: 4 }],
    set_aside: [1, {}, "a"],
    end: "over",
  });
  expect(guide.program).toBe("");
  expect(guide.wantsNumber).toBe(false);
  expect([guide.asked, guide.nDone, guide.nTotal, guide.nRedone]).toEqual([0, 0, 0, 0]);
  expect(guide.touches).toEqual([{ x: 1, y: 2, isDone: false }]);
  expect([guide.target, guide.load, guide.held, guide.end]).toEqual([undefined, undefined, undefined, undefined]);
  expect(guide.quality).toEqual([{ name: "a", ok: undefined, text: "" }]);
  expect(guide.setAside).toEqual(["a"]);
});

const STEP = {
  phase: "report",
  step: 7,
  text: "Force off by 17 mN.",
  is_bad: true,
  part: null,
  choices: [{ word: "more", label: "Press 6 more", hint: "again" }],
  fields: [{ name: "grams", label: "Weights", value: "50", unit: "g" }],
  gates: [{ name: "touches", ok: false, text: "9, at least 10", remedy: "press more" }, { name: "unit", ok: null, text: "not tried", remedy: "" }],
  report: 7,
};

test("a step of a calibration is read; a collection of the command line has none", () => {
  expect(read().step).toBeUndefined();
  expect(read(STEP).step).toEqual({
    phase: "report",
    number: 7,
    text: "Force off by 17 mN.",
    isBad: true,
    part: undefined,
    choices: [{ word: "more", label: "Press 6 more", hint: "again" }],
    fields: [{ name: "grams", label: "Weights", value: "50", unit: "g" }],
    gates: [{ name: "touches", ok: false, text: "9, at least 10", remedy: "press more" }, { name: "unit", ok: undefined, text: "not tried", remedy: "" }],
    report: 7,
  });
});

test("of a step, too, only what makes sense is read", () => {
  const strange = { phase: "x".repeat(999), step: -1, text: 7, is_bad: "yes", part: 2, choices: [1, null, [], { word: {} }], fields: "none", gates: { ok: true }, report: "../x" };
  expect(read(strange).step).toEqual({
    phase: "x".repeat(600),
    number: 0,
    text: "",
    isBad: false,
    part: undefined,
    choices: [{ word: "", label: "", hint: "" }],
    fields: [],
    gates: [],
    report: undefined,
  });
});

test("what is too long is cut", () => {
  const guide = read({ said: "x".repeat(1e6), touches: Array.from({ length: 20_000 }, () => [0, 0, 1]), quality: Array.from({ length: 999 }, () => GOOD.quality[0]) });
  expect(guide.said.length).toBe(600);
  expect(guide.touches.length).toBe(5000);
  expect(guide.quality.length).toBe(32);
});

test("whatever is put in the place of a part, something is read or nothing, and nothing is thrown", () => {
  const next = randomNumbers(7);
  const strange = [null, NaN, -1, 1e308, "", "x", true, [], [[]], [[1, 2]], {}, { ok: {} }, [{ name: [] }]];
  const keys = Object.keys({ ...GOOD, ...STEP });
  for (let i = 0; i < 3000; i++) {
    const changes = Object.fromEntries([0, 1, 2].map(() => [keys[next() % keys.length]!, strange[next() % strange.length]]));
    const guide = readGuide({ ...GOOD, ...STEP, ...changes });
    if (!guide) continue;
    for (const n of [guide.asked, guide.nDone, guide.nTotal, ...guide.touches.flatMap((t) => [t.x, t.y])]) expect(Number.isFinite(n)).toBe(true);
    expect(guide.held === undefined || (guide.held >= 0 && guide.held <= 1)).toBe(true);
  }
});

test("how far the plan's places are from the nearest touch", () => {
  const at = (x: number, y: number, isDone: boolean) => ({ x, y, isDone });
  expect(largestGap([])).toBeUndefined();
  expect(largestGap([at(0, 0, false)])).toBeUndefined();
  expect(largestGap([at(0, 0, true), at(3, 4, false), at(6, 0, true)])).toBe(5);
});
