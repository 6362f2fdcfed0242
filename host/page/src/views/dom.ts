// Small helpers to make elements.

type Attributes = Record<string, string>;

/** An element with attributes and children; strings become text, never markup. */
export function make<K extends keyof HTMLElementTagNameMap>(
  tag: K,
  attributes: Attributes = {},
  ...children: (Node | string)[]
): HTMLElementTagNameMap[K] {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, value);
  element.append(...children);
  return element;
}

/** A button with a key that does the same. */
export function button(label: string, key: string, hint: string, press: () => void): HTMLButtonElement {
  const element = make("button", { type: "button", title: `${hint} (key ${key})`, "data-key": key.toLowerCase() }, label);
  element.addEventListener("click", press);
  return element;
}

/** A table of rows of text. */
export function fillTable(body: HTMLTableSectionElement, rows: string[][]): void {
  body.replaceChildren(...rows.map((row) => make("tr", {}, ...row.map((cell) => make("td", {}, cell)))));
}

/** POINT_SIZE -> point size. */
export function words(name: string): string {
  return name.toLowerCase().replaceAll("_", " ");
}

/** camelCase -> camel case. */
export function spaced(name: string): string {
  return name.replace(/[A-Z]/g, (c) => ` ${c.toLowerCase()}`);
}
