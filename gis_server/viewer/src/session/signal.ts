/** A signal and its listeners. Listeners exist as long as the session. */

export class Signal<T> {
  private readonly listeners = new Set<(value: T) => void>();

  /** Calls `listener` with every later value; the returned function stops that. */
  on(listener: (value: T) => void): () => void {
    this.listeners.add(listener);
    return () => void this.listeners.delete(listener);
  }

  emit(value: T): void {
    for (const listener of [...this.listeners]) listener(value);
  }
}

/** A signal that is kept until its listeners exist: the last earlier call then reaches them. */
export class HeldSignal<T> extends Signal<T> {
  private isHeld = true;
  private kept: readonly [T] | null = null;

  override emit(value: T): void {
    if (this.isHeld) this.kept = [value];
    else super.emit(value);
  }

  /** All listeners are there. */
  release(): void {
    this.isHeld = false;
    if (this.kept) super.emit(this.kept[0]);
    this.kept = null;
  }
}
