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
