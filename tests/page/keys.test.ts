// Which button a key presses, and which it must not.

import type { Step } from "../../host/page/src/guide";
import { enterOf, pressKey } from "../../host/page/src/keys";

function step(words: string[], nFields = 0): Step {
  const choices = words.map((word) => ({ word, label: word, hint: "" }));
  const fields = Array.from({ length: nFields }, () => ({ name: "grams", label: "", value: "", unit: "g" }));
  return { phase: "", number: 1, text: "", isBad: false, part: undefined, choices, fields, gates: [], report: undefined };
}

test.each([
  [["continue", "begin", "undo", "close"], 4, "begin"], // what was filled in is not thrown away
  [["begin", "close"], 4, "begin"],
  [["close"], 1, ""],
  [["continue", "close"], 0, "continue"],
  [["flash", "more", "close"], 0, ""],
  [["more", "close"], 0, "more"],
  [[], 0, ""],
])("of %j with %i fields Enter means %j", (words, nFields, word) => {
  expect(enterOf(step(words, nFields))).toBe(word);
});

/** What a key does: "click" of the button that has it, "kept" from the browser, both or nothing. */
function does(key: string, on: string, repeat = false, buttonKey = "enter"): string[] {
  const done: string[] = [];
  const hidden = { dataset: { key: buttonKey }, hidden: true, click: () => done.push("hidden") };
  const shown = { dataset: { key: buttonKey }, hidden: false, click: () => done.push("click") };
  const event = { key, repeat, target: { tagName: on }, preventDefault: () => done.push("kept") };
  pressKey(event as unknown as KeyboardEvent, [hidden, shown] as unknown as HTMLButtonElement[]);
  return done;
}

test("a key presses its button once, however long it is held", () => {
  expect(does("Enter", "BODY")).toEqual(["kept", "click"]);
  expect(does("Enter", "INPUT")).toEqual(["kept", "click"]);
  expect(does("Enter", "INPUT", true)).toEqual(["kept"]);
  expect(does("Enter", "BUTTON", true)).toEqual(["kept"]);
  expect(does("R", "BODY", false, "r")).toEqual(["kept", "click"]);
  expect(does("r", "BODY", true, "r")).toEqual(["kept"]);
});

test("a key that the browser uses where it is pressed is left to it", () => {
  expect(does("Enter", "BUTTON")).toEqual([]);
  expect(does(" ", "BUTTON", false, " ")).toEqual([]);
  expect(does("r", "INPUT", false, "r")).toEqual([]);
  expect(does("ArrowDown", "BODY", true)).toEqual([]);
});
