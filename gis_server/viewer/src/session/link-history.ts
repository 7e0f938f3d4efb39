/**
 * The links to the views of a session in the browser's history: an entry for every gesture that changed something.
 *
 * What changes without a gesture (the page settles, layers come) changes the entry that is there.
 */

/** Turns of the wheel within this time are one gesture. */
const PAUSE_MS = 700;

interface Entry {
  /** Number of the view, from 0. */
  readonly view: number;
}

export class LinkHistory {
  private hasGesture = false;
  private turned = Number.NEGATIVE_INFINITY;
  private last = 0;

  constructor(alive: AbortSignal) {
    const gesture = () => {
      this.hasGesture = true;
    };
    const wheel = () => {
      const now = performance.now();
      if (now - this.turned > PAUSE_MS) gesture();
      this.turned = now;
    };
    const listening = { capture: true, passive: true, signal: alive };
    window.addEventListener("pointerdown", gesture, listening);
    window.addEventListener("keydown", gesture, listening);
    window.addEventListener("wheel", wheel, listening);
    this.last = this.view;
  }

  write(address: string): void {
    if (address === location.hash) return;
    const { view } = this;
    if (!this.hasGesture) {
      history.replaceState({ view }, "", address);
      return;
    }
    this.hasGesture = false;
    this.last = view + 1;
    history.pushState({ view: this.last }, "", address);
  }

  /** Shows another link, in an entry of its own. */
  open(link: string): void {
    this.hasGesture = true;
    this.write(link);
    window.dispatchEvent(new PopStateEvent("popstate", { state: history.state as Entry }));
  }

  /** Another entry of the history is shown: changes that follow from it are not gestures. */
  moved(): void {
    this.hasGesture = false;
  }

  undo(): void {
    if (this.view > 0) history.back();
  }

  redo(): void {
    if (this.view < this.last) history.forward();
  }

  private get view(): number {
    return (history.state as Entry | null)?.view ?? 0;
  }
}
