/** Waiting for the server, and saying what went wrong. `html[data-ready]` tells whether all has come. */

import type { Shell } from "../page/shell";
import { ApiError, UnreachableError } from "../server/api";

export class Waiting {
  private pending = 0;
  private isAway = false;

  constructor(
    private readonly page: Shell,
    private readonly onDone: () => void,
  ) {}

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
    this.page.banner(message, () => this.page.banner(null));
  }

  /** The server answered: if it was away, it no longer is. */
  answered(): void {
    if (this.isAway) this.page.banner(null);
    this.isAway = false;
  }

  unsettle(): void {
    document.documentElement.dataset["ready"] = "false";
  }

  /** The map is drawn; if nothing is awaited either, all is there. */
  settle(): void {
    if (this.pending === 0) document.documentElement.dataset["ready"] = "true";
  }
}
