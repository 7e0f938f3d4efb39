/** A value that several parts look at, and what of it stands in the link. */

import { Signal } from "./signal";

export class Kept<T> {
  readonly changed = new Signal<T>();

  constructor(private current: T) {}

  get value(): T {
    return this.current;
  }

  set(value: T): void {
    this.current = value;
    this.changed.emit(value);
  }
}

/** What parts keep in the link, each under keys of its own. */
export class LinkBook {
  readonly changed = new Signal<void>();
  private readonly entries: Map<string, string>;

  constructor(from: ReadonlyMap<string, string>) {
    this.entries = new Map(from);
  }

  read(key: string): string | null {
    return this.entries.get(key) ?? null;
  }

  /** Null or nothing takes the key out of the link. */
  write(key: string, text: string | null): void {
    if (text) this.entries.set(key, text);
    else this.entries.delete(key);
    this.changed.emit();
  }

  get all(): ReadonlyMap<string, string> {
    return this.entries;
  }
}
