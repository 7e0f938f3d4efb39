/**
 * The links to the views of a session in the browser's history: an entry for every gesture that changed something.
 *
 * What changes without a gesture (the page settles, layers come) changes the entry that is there.
 */

/** Turns of the wheel within this time are one gesture. */
const PAUSE_MS = 700;
/** Least time between writes of continuous changes: browsers allow about a hundred entries in half a minute. */
const REST_MS = 150;

interface Entry {
  /** Number of the view, from 0. */
  readonly view: number;
}

export class LinkHistory {
  private hasGesture = false;
  private turned = Number.NEGATIVE_INFINITY;
  private last = 0;
  private resting: ReturnType<typeof setTimeout> | undefined;

  /** `now` is the link to what is shown. */
  constructor(
    private readonly signal: AbortSignal,
    private readonly now: () => string,
  ) {
    const gesture = () => {
      this.flush();
      this.hasGesture = true;
    };
    const wheel = () => {
      const now = performance.now();
      if (now - this.turned > PAUSE_MS) gesture();
      this.turned = now;
    };
    const listening = { capture: true, passive: true, signal };
    window.addEventListener("pointerdown", gesture, listening);
    window.addEventListener("keydown", gesture, listening);
    window.addEventListener("wheel", wheel, listening);
    signal.addEventListener("abort", () => this.moved());
    this.last = this.view;
  }

  /** Called when the view changes: the first change of a gesture is written at once, later ones at intervals. */
  changed(): void {
    if (this.signal.aborted) return;
    if (this.hasGesture) queueMicrotask(() => this.hasGesture && this.write());
    else this.resting ??= setTimeout(() => this.write(), REST_MS);
  }

  /** Writes changes that are not written yet. */
  flush(): void {
    if (this.resting !== undefined) this.write();
  }

  private write(): void {
    this.stop();
    const address = this.now();
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

  private stop(): void {
    clearTimeout(this.resting);
    this.resting = undefined;
  }

  /** Shows another link, in an entry of its own. */
  open(link: string): void {
    this.flush();
    this.last = this.view + 1;
    history.pushState({ view: this.last }, "", link);
    window.dispatchEvent(new PopStateEvent("popstate", { state: history.state as Entry }));
  }

  /** Another entry of the history is shown: changes that follow from it are not gestures. */
  moved(): void {
    this.stop();
    this.hasGesture = false;
  }

  undo(): void {
    this.flush();
    if (this.view > 0) history.back();
  }

  redo(): void {
    if (this.view < this.last) history.forward();
  }

  private get view(): number {
    return (history.state as Entry | null)?.view ?? 0;
  }
}
