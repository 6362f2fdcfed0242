// Asks before a calibration is replaced, and shows how far it is.

const find = <T extends HTMLElement>(id: string): T => document.querySelector<T>(`#${id}`)!;

export class FlashDialog {
  private readonly dialog = find<HTMLDialogElement>("flash");
  private readonly go = find<HTMLButtonElement>("flash-go");
  private readonly close = find<HTMLButtonElement>("flash-close");
  private readonly part = find<HTMLProgressElement>("flash-part");
  private readonly said = find("flash-said");
  private begin: () => void = () => undefined;

  constructor() {
    this.go.addEventListener("click", () => {
      this.go.disabled = this.close.disabled = true;
      this.begin();
    });
    this.dialog.addEventListener("cancel", (event) => this.close.disabled && event.preventDefault());
  }

  /** `what` will change, in a sentence or two; nothing happens before the person says so. */
  ask(what: string, begin: () => void): void {
    find("flash-what").textContent = what;
    this.begin = begin;
    this.show(0, "", true);
    this.go.hidden = this.go.disabled = this.close.disabled = false;
    this.close.textContent = "Cancel";
    this.dialog.showModal();
  }

  /** It cannot be done from here: `why`, and what to do instead. */
  refuse(why: string): void {
    this.ask("", () => undefined);
    this.show(0, why, false);
    this.end();
  }

  show(part: number, text: string, isOk: boolean): void {
    this.part.value = part;
    this.said.textContent = text;
    this.said.classList.toggle("bad", !isOk);
  }

  /** No more comes. */
  end(): void {
    this.go.hidden = true;
    this.close.disabled = false;
    this.close.textContent = "Close";
  }
}
