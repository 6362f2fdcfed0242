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
  for (const picture of root.querySelectorAll("canvas")) {
    const box = picture.getBoundingClientRect();
    if (box.width && box.height) context.drawImage(picture, box.left, box.top, box.width, box.height);
  }
  writeTexts(root, context);
  return out;
}

/** Each piece of text where the browser has set it. */
function writeTexts(root: HTMLElement, context: CanvasRenderingContext2D): void {
  const walker = document.createTreeWalker(root, NodeFilter.SHOW_TEXT);
  const range = document.createRange();
  context.textBaseline = "alphabetic";
  while (walker.nextNode()) {
    const node = walker.currentNode;
    const said = node.textContent?.trim();
    if (!said || !node.parentElement) continue;
    range.selectNodeContents(node);
    const box = range.getClientRects()[0];
    if (!box) continue;
    const style = getComputedStyle(node.parentElement);
    context.font = `${style.fontWeight} ${style.fontSize} ${style.fontFamily}`;
    context.fillStyle = style.color;
    context.fillText(said, box.left, box.top + 0.78 * box.height);
  }
}
