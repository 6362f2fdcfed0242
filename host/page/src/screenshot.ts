// What is on the screen as one PNG: the canvases where they are, and the numbers beside them.

const MARGIN_PX = 12;

/** Draw all that `root` shows on one canvas and save it. */
export async function screenshot(root: HTMLElement): Promise<void> {
  const canvas = compose(root);
  const blob = await new Promise<Blob | null>((resolve) => canvas.toBlob(resolve));
  if (blob) save(blob, "png");
}

/** Give a file to the person, named by the time. */
export function save(blob: Blob, ending: string): void {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(blob);
  link.download = `ruffini-${new Date().toISOString().replace(/[:.]/g, "-")}.${ending}`;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 60_000);
}

function compose(root: HTMLElement): HTMLCanvasElement {
  const all = root.getBoundingClientRect();
  const ratio = window.devicePixelRatio;
  const out = document.createElement("canvas");
  out.width = (all.width + 2 * MARGIN_PX) * ratio;
  out.height = (all.height + 2 * MARGIN_PX) * ratio;
  const context = out.getContext("2d")!;
  context.scale(ratio, ratio);
  context.translate(MARGIN_PX - all.left, MARGIN_PX - all.top);
  const style = getComputedStyle(document.documentElement);
  context.fillStyle = style.getPropertyValue("--paper");
  context.fillRect(all.left - MARGIN_PX, all.top - MARGIN_PX, all.width + 2 * MARGIN_PX, all.height + 2 * MARGIN_PX);
  for (const element of root.querySelectorAll("*")) {
    const box = element.getBoundingClientRect();
    if (!box.width || !box.height) continue;
    if (element instanceof HTMLCanvasElement) context.drawImage(element, box.left, box.top, box.width, box.height);
    else drawBox(getComputedStyle(element), box, context);
  }
  writeTexts(root, context);
  return out;
}

/** Its ground and borders: cards, bars, the colours of a legend. */
function drawBox(style: CSSStyleDeclaration, box: DOMRect, context: CanvasRenderingContext2D): void {
  if (style.visibility === "hidden") return;
  context.fillStyle = style.backgroundColor;
  context.fillRect(box.left, box.top, box.width, box.height);
  const sides = [
    [style.borderTopWidth, style.borderTopColor, (n: number) => [box.left, box.top, box.width, n]],
    [style.borderBottomWidth, style.borderBottomColor, (n: number) => [box.left, box.bottom - n, box.width, n]],
    [style.borderLeftWidth, style.borderLeftColor, (n: number) => [box.left, box.top, n, box.height]],
    [style.borderRightWidth, style.borderRightColor, (n: number) => [box.right - n, box.top, n, box.height]],
  ] as const;
  for (const [width, colour, place] of sides) {
    context.fillStyle = colour;
    context.fillRect(...(place(parseFloat(width)) as [number, number, number, number]));
  }
}

/** Each piece of text where the browser has set it. */
function writeTexts(root: HTMLElement, context: CanvasRenderingContext2D): void {
  const walker = document.createTreeWalker(root, NodeFilter.SHOW_TEXT);
  const range = document.createRange();
  context.textBaseline = "alphabetic";
  while (walker.nextNode()) {
    const node = walker.currentNode as Text;
    if (!node.parentElement) continue;
    const style = getComputedStyle(node.parentElement);
    context.font = `${style.fontWeight} ${style.fontSize} ${style.fontFamily}`;
    context.fillStyle = style.color;
    for (const { words, box } of linesOf(node, range)) context.fillText(words, box.left, box.top + 0.78 * box.height);
  }
}

/** The lines into which the browser has broken a text. */
function linesOf(node: Text, range: Range): { words: string; box: DOMRect }[] {
  const lines: { words: string; box: DOMRect }[] = [];
  for (const word of node.data.matchAll(/\S+/g)) {
    range.setStart(node, word.index);
    range.setEnd(node, word.index + word[0].length);
    const box = range.getClientRects()[0];
    if (!box) continue; // not shown
    const last = lines.at(-1);
    if (last && Math.abs(last.box.top - box.top) < box.height / 2) last.words += ` ${word[0]}`;
    else lines.push({ words: word[0], box });
  }
  return lines;
}
