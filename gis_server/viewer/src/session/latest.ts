/** Requests that follow the pointer: only the last one is answered, and not before the pointer rests. */

import { ApiError } from "../server/api";

export class Latest {
  private timer: ReturnType<typeof setTimeout> | undefined;
  private running: AbortController | null = null;

  /** `fail` receives errors other than missing values. */
  constructor(
    private readonly restMs: number,
    private readonly fail: (reason: unknown) => void,
  ) {}

  run(work: (signal: AbortSignal) => Promise<void>): void {
    this.stop();
    const running = new AbortController();
    this.running = running;
    this.timer = setTimeout(() => {
      work(running.signal).catch((reason: unknown) => {
        if (!running.signal.aborted && !isRefusal(reason)) this.fail(reason);
      });
    }, this.restMs);
  }

  stop(): void {
    clearTimeout(this.timer);
    this.running?.abort();
  }
}

/** Whether the server answered that there is no value. */
export const isRefusal = (reason: unknown): boolean =>
  reason instanceof ApiError && (reason.status === 404 || reason.status === 422);
