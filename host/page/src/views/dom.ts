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

/** A button with a key that does the same; an empty key: none does. */
export function button(label: string, key: string, hint: string, press: () => void): HTMLButtonElement {
  const keyed: Attributes = key ? { title: `${hint} (key ${key})`, "data-key": key.toLowerCase() } : { title: hint };
  const element = make("button", { type: "button", ...keyed }, label);
  element.addEventListener("click", press);
  return element;
}

/** Text that is the same is not written again: the browser would lay the page out again. */
export function write(element: Element, text: string): void {
  if (element.textContent !== text) element.textContent = text;
}

/** A table of rows of text; cells that stay are kept. */
export function fillTable(body: HTMLTableSectionElement, rows: string[][]): void {
  while (body.rows.length > rows.length) body.deleteRow(-1);
  rows.forEach((row, i) => {
    const found = body.rows[i] ?? body.insertRow();
    if (found.cells.length === row.length && !found.querySelector(".none")) row.forEach((cell, k) => write(found.cells[k]!, cell));
    else found.replaceChildren(...row.map((cell) => make("td", {}, cell)));
  });
}

/** POINT_SIZE -> point size. */
export function words(name: string): string {
  return name.toLowerCase().replaceAll("_", " ");
}

/** camelCase -> camel case. */
export function spaced(name: string): string {
  return name.replace(/[A-Z]/g, (c) => ` ${c.toLowerCase()}`);
}
