/** A value that several parts share, and that no link holds. */

import { Signal } from "./signal";

export class Observable<T> {
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
