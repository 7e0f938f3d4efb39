/** Calls that come in bursts, gathered to one. */

export interface Gathered<T> {
  /** Adds items, which are processed after a pause of this length. */
  readonly add: (one: T, quiet_ms?: number) => void;
  readonly cancel: () => void;
}

/** A call that waits for a pause in the arrivals, then processes all of them. */
export function gathered<T>(usual_ms: number, work: (all: readonly T[]) => void): Gathered<T> {
  let waiting: T[] = [];
  let timer: ReturnType<typeof setTimeout> | undefined;
  const go = () => {
    const all = waiting;
    waiting = [];
    work(all);
  };
  return {
    add(one, quiet_ms = usual_ms) {
      waiting.push(one);
      clearTimeout(timer);
      timer = setTimeout(go, quiet_ms);
    },
    cancel: () => clearTimeout(timer),
  };
}

/** Published layers in words: kinds and scopes, not every product. */
export function publishedText(ids: readonly string[]): string {
  const unique = [...new Set(ids)];
  const scopes = new Set(unique.map((id) => id.slice(0, id.lastIndexOf("/"))));
  const layers = unique.length === 1 ? "1 layer" : `${unique.length} layers`;
  const places = scopes.size === 1 ? [...scopes][0] : `${scopes.size} places`;
  return `${layers} of ${places} published`;
}
