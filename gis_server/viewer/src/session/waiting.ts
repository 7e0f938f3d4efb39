/** Waiting for the server, and reporting errors. `html[data-ready]` states whether all has been loaded. */

import type { Shell } from "../page/shell";
import { ApiError, api, UnreachableError } from "../server/api";

/** Mark in the browser's timeline of the moment when the first view of the map was drawn. */
const MAP_PAINTED = "map painted";

/** Failed requests are repeated when the server answers; it is polled after this time, then less and less often. */
const FIRST_AGAIN_MS = 3000;
const LAST_AGAIN_MS = 60_000;

export class Waiting {
  /** The first view of the map is drawn, with all that it shows. */
  readonly painted: Promise<void>;
  private paint: (() => void) | null = null;
  private pending = 0;
  private resolvers: (() => void)[] = [];
  private isWhole = false;
  private isAway = false;
  /** Failed requests, to be repeated when the server answers. */
  private readonly unanswered = new Set<() => Promise<void>>();
  private timer: ReturnType<typeof setTimeout> | undefined;
  private pause_ms = FIRST_AGAIN_MS;

  constructor(
    private readonly page: Shell,
    private readonly onDone: () => void,
  ) {
    this.painted = new Promise((resolve) => {
      this.paint = resolve;
    });
  }

  /** Runs code that reads from the server, again where it does not answer; errors are shown on the banner. */
  run(work: () => Promise<void>): void {
    this.await(work, true);
  }

  /** Runs code that writes: once, whether or not the server answers. */
  act(work: () => Promise<void>): void {
    this.await(work, false);
  }

  private await(work: () => Promise<void>, isRepeated: boolean): void {
    this.pending += 1;
    this.markLoading();
    work()
      .catch((reason: unknown) => {
        if (isRepeated && reason instanceof UnreachableError) this.unanswered.add(work);
        this.fail(reason);
      })
      .finally(() => {
        this.pending -= 1;
        if (this.pending === 0) this.onDone();
      });
  }

  fail(reason: unknown): void {
    if (reason instanceof DOMException && reason.name === "AbortError") return;
    this.isAway = reason instanceof UnreachableError;
    if (reason instanceof UnreachableError) {
      this.page.banner(reason.message, () => void this.retry());
      clearTimeout(this.timer);
      this.timer = setTimeout(() => void this.retry(), this.pause_ms);
    } else if (reason instanceof ApiError) this.notify(reason.message);
    else throw reason;
  }

  /** Loads what failed, if the server answers now; the page stays as it is. */
  private async retry(): Promise<void> {
    clearTimeout(this.timer);
    this.pause_ms = Math.min(2 * this.pause_ms, LAST_AGAIN_MS);
    if (await api.isAlive()) this.answered();
    else this.timer = setTimeout(() => void this.retry(), this.pause_ms);
  }

  /** The session ends: nothing is tried again. */
  stop(): void {
    clearTimeout(this.timer);
    this.unanswered.clear();
  }

  /** Shows a message that disappears by itself. */
  notify(message: string): void {
    this.page.banner(message, () => this.page.banner(null), "Close");
  }

  /** Called after an answer: if the server had been unreachable, failed requests are repeated. */
  answered(): void {
    clearTimeout(this.timer);
    if (this.isAway) this.page.banner(null);
    this.isAway = false;
    const failed = [...this.unanswered];
    this.unanswered.clear();
    for (const work of failed) this.run(work);
    if (failed.length === 0) this.pause_ms = FIRST_AGAIN_MS;
  }

  /** Resolves when no request is pending and the map is drawn. */
  async settled(): Promise<void> {
    const settled = new Promise<void>((resolve) => this.resolvers.push(resolve));
    this.onDone(); // draws the map, because it may be drawn already
    await settled;
  }

  markLoading(): void {
    document.documentElement.dataset["ready"] = "false";
  }

  /** The page has all of its parts, before or after the first view of the map is drawn. */
  whole(): void {
    this.isWhole = true;
  }

  /** The map is drawn; if no request is pending, the page may be complete. */
  settle(): void {
    if (this.pending > 0) return;
    if (this.paint) {
      performance.mark(MAP_PAINTED);
      this.paint();
      this.paint = null;
    }
    for (const resolve of this.resolvers.splice(0)) resolve();
    if (this.isWhole) document.documentElement.dataset["ready"] = "true";
  }
}
