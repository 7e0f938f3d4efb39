/** The state of the viewer: parts read its fields, write them, and are called when somebody else does. */

import { Signal } from "./signal";
import { formatLink, type Key, parseLink, type State, textOf } from "./state";

type Listener = (value: never) => void;

export class Store {
  /** A field has another value. */
  readonly changed = new Signal<Key>();
  private readonly listeners = new Map<Key, Set<Listener>>();
  private state: State;
  /** Parts of the last link that are not known. */
  unknown: readonly string[];

  constructor(link: string) {
    ({ state: this.state, unknown: this.unknown } = parseLink(link));
  }

  get<K extends Key>(key: K): State[K] {
    return this.state[key];
  }

  set<K extends Key>(key: K, value: State[K]): void {
    this.put(key, value);
  }

  /** Calls `listener` with every later value; the answer ends that. */
  on<K extends Key>(key: K, listener: (value: State[K]) => void): () => void {
    const all = this.listeners.get(key) ?? new Set();
    this.listeners.set(key, all.add(listener as Listener));
    return () => void all.delete(listener as Listener);
  }

  /** Calls `show` with the value now and whenever it changes; the answer sets the value without calling it. */
  follow<K extends Key>(key: K, show: (value: State[K]) => void): (value: State[K]) => void {
    this.on(key, show);
    show(this.get(key));
    return (value) => this.put(key, value, show as Listener);
  }

  /** Takes over all that another link holds. */
  restore(link: string): void {
    const before = this.state;
    ({ state: this.state, unknown: this.unknown } = parseLink(link));
    const others = (Object.keys(before) as Key[]).filter(
      (key) => textOf(key, before[key]) !== textOf(key, this.state[key]),
    );
    for (const key of others) this.emit(key);
  }

  get link(): string {
    return formatLink(this.state);
  }

  /** The link to the same with another value. */
  linkWith(part: Partial<State>): string {
    return formatLink({ ...this.state, ...part });
  }

  private put<K extends Key>(key: K, value: State[K], except?: Listener): void {
    const isSame = textOf(key, value) === textOf(key, this.state[key]);
    this.state = { ...this.state, [key]: value };
    if (!isSame) this.emit(key, except);
  }

  private emit(key: Key, except?: Listener): void {
    const value = this.state[key] as never;
    for (const listener of [...(this.listeners.get(key) ?? [])])
      if (listener !== except) listener(value);
    this.changed.emit(key);
  }
}
