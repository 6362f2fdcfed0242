// What a key that is pressed does: that of the button which has it.

import type { Step } from "./guide";

/** The word of the choice that Enter makes; empty: of none. */
export function enterOf({ choices, fields }: Step): string {
  const word = (fields.length ? choices.find((c) => c.word === "begin") : choices[0])?.word ?? "";
  return word === "flash" ? "" : word; // what the sensor measures with is never changed by a key too many
}

/** Press the button that has the key, unless the browser does something with it where it was pressed. */
export function pressKey(event: KeyboardEvent, buttons: HTMLButtonElement[]): void {
  const on = (event.target as Element | null)?.tagName;
  if (on === "INPUT" && event.key !== "Enter") return; // typed into it
  if (on === "BUTTON" && event.key === " ") return; // presses that button
  const isHeld = event.repeat; // one press, however long
  if (on === "BUTTON" && event.key === "Enter" && !isHeld) return; // likewise
  const found = buttons.find((b) => b.dataset["key"] === event.key.toLowerCase() && !b.hidden);
  if (found || (isHeld && event.key === "Enter")) event.preventDefault();
  if (!isHeld) found?.click();
}
