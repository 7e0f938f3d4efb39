/** A value that several parts share, and its part of the link. */

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

/** Values of parts in the link, each under keys of its own. */
export class LinkBook {
  readonly changed = new Signal<void>();
  private readonly restored = new Signal<ReadonlySet<string>>();
  private readonly known = new Set<string>();
  private entries: Map<string, string>;

  constructor(from: ReadonlyMap<string, string>) {
    this.entries = new Map(from);
  }

  read(key: string): string | null {
    this.known.add(key);
    return this.entries.get(key) ?? null;
  }

  /** Calls `show` with the value of a key, if any, and again when another link is followed. */
  follow(key: string, show: (text: string | null) => void): void {
    const text = this.read(key);
    if (text !== null) show(text);
    this.onRestored(key, () => show(this.read(key)));
  }

  /** Calls `restored` when a link with another value under a key is followed. */
  onRestored(key: string, restored: () => void): void {
    this.known.add(key);
    this.restored.on((keys) => {
      if (keys.has(key)) restored();
    });
  }

  /** Takes over the values of another link. */
  restore(entries: ReadonlyMap<string, string>): void {
    const before = this.entries;
    this.entries = new Map(entries);
    const keys = new Set([...before.keys(), ...entries.keys()]);
    this.restored.emit(new Set([...keys].filter((key) => before.get(key) !== entries.get(key))));
  }

  /** Keys that no part uses. */
  get unknown(): readonly string[] {
    return [...this.entries.keys()].filter((key) => !this.known.has(key));
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
