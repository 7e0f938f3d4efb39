/** Waiting for the server, and saying what went wrong. `html[data-ready]` tells whether all has come. */

import type { Shell } from "../page/shell";
import { ApiError, UnreachableError } from "../server/api";

/** Mark in the browser's timeline of the moment when the first view of the map was drawn. */
const MAP_PAINTED = "map painted";

export class Waiting {
  /** The first view of the map is drawn, with all that it shows. */
  readonly painted: Promise<void>;
  private paint: (() => void) | null = null;
  private pending = 0;
  private isWhole = false;
  private isAway = false;

  constructor(
    private readonly page: Shell,
    private readonly onDone: () => void,
  ) {
    this.painted = new Promise((resolve) => {
      this.paint = resolve;
    });
  }

  /** Runs what needs the server; what goes wrong is said on the banner. */
  run(work: () => Promise<void>): void {
    this.pending += 1;
    this.unsettle();
    work()
      .catch((reason: unknown) => this.fail(reason))
      .finally(() => {
        this.pending -= 1;
        if (this.pending === 0) this.onDone();
      });
  }

  fail(reason: unknown): void {
    if (reason instanceof DOMException && reason.name === "AbortError") return;
    this.isAway = reason instanceof UnreachableError;
    if (reason instanceof UnreachableError)
      this.page.banner(reason.message, () => location.reload());
    else if (reason instanceof ApiError) this.say(reason.message);
    else throw reason;
  }

  /** Shows a message that goes away when it was read. */
  say(message: string): void {
    this.page.banner(message, () => this.page.banner(null), "Close");
  }

  /** The server answered: if it was away, it no longer is. */
  answered(): void {
    if (this.isAway) this.page.banner(null);
    this.isAway = false;
  }

  unsettle(): void {
    document.documentElement.dataset["ready"] = "false";
  }

  /** The page has all of its parts, before or after the first view of the map is drawn. */
  whole(): void {
    this.isWhole = true;
  }

  /** The map is drawn; if nothing is awaited either, what the page has is there, and that may be all. */
  settle(): void {
    if (this.pending > 0) return;
    if (this.paint) {
      performance.mark(MAP_PAINTED);
      this.paint();
      this.paint = null;
    }
    if (this.isWhole) document.documentElement.dataset["ready"] = "true";
  }
}
