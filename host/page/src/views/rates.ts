// What the sensor is asked for, and how often: a slow line has no room for all of it.

import { make } from "./dom";

const CHOICES: [number, string][] = [[0, "off"], [1, "each frame"], [2, "each 2nd"], [4, "each 4th"], [6, "each 6th"], [15, "each 15th"], [30, "each 30th"], [60, "each 60th"]];
const WHAT: Record<string, string> = {
  wrench: "Wrench",
  field: "Field",
  contacts: "Contacts",
  depth: "Depth",
  learned: "Network",
  image: "Camera's picture",
  residual: "Not explained",
};
const ON = { image: 6, residual: 4 }; // when their buttons ask for them: a picture is large, a residual costs two products

/** How often each result is wanted, and the dialog that changes it. */
export class Rates {
  // A depth map is larger than all the rest of its frame.
  private readonly every: Record<string, number> = { wrench: 1, field: 1, contacts: 1, depth: 4, learned: 1, image: 0, residual: 0 };
  private readonly choosers = new Map<string, HTMLSelectElement>();
  private readonly dialog = document.querySelector<HTMLDialogElement>("#rates")!;

  constructor(private readonly onChange: () => void) {
    const rows = Object.entries(WHAT).map(([name, label]) => {
      const chooser = make("select", { name }, ...CHOICES.map(([n, said]) => make("option", { value: String(n) }, said)));
      chooser.addEventListener("change", () => this.set(name, Number(chooser.value)));
      this.choosers.set(name, chooser);
      return make("label", {}, make("span", {}, label), chooser);
    });
    this.dialog.querySelector(".rows")!.append(...rows);
    this.show();
  }

  /** As a sensor is asked: what is off is left out. */
  get subscription(): Record<string, number> {
    return { status: 1, ...Object.fromEntries(Object.entries(this.every).filter(([, n]) => n > 0)) };
  }

  wants(name: keyof typeof ON): boolean {
    return this.every[name]! > 0;
  }

  toggle(name: keyof typeof ON): void {
    this.set(name, this.wants(name) ? 0 : ON[name]);
  }

  open(): void {
    this.dialog.showModal();
  }

  private set(name: string, n: number): void {
    this.every[name] = n;
    this.show();
    this.onChange();
  }

  private show(): void {
    for (const [name, chooser] of this.choosers) chooser.value = String(this.every[name]);
  }
}
