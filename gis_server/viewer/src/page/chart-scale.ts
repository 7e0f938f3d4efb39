/** Scales, ticks and paths of charts: numbers in, numbers and path strings out. */

/** NaN and null both mean "not measured": lines and bands have a gap there. */
export type Values = readonly (number | null)[];
export type Interval = readonly [low: number, high: number];

export interface Scale {
  readonly domain: Interval;
  (value: number): number;
  invert(pixel: number): number;
}

export const isNumber = (value: number | null | undefined): value is number =>
  typeof value === "number" && Number.isFinite(value);

export function linear(domain: Interval, [from, to]: Interval): Scale {
  const [low, high] = domain;
  const span = high - low || 1;
  const scale = (value: number) => from + ((value - low) / span) * (to - from);
  const invert = (pixel: number) => low + ((pixel - from) / (to - from || 1)) * span;
  return Object.assign(scale, { domain, invert });
}

/** Distance of ticks: 1, 2 or 5 times a power of ten, so that there are about `count` of them. */
export function tickStep([low, high]: Interval, count: number): number {
  const rough = Math.max((high - low) / Math.max(count, 1), Number.MIN_VALUE);
  const decade = 10 ** Math.floor(Math.log10(rough));
  const factor = [1, 2, 5].find((one) => one * decade >= rough * (1 - 1e-9)) ?? 10;
  return factor * decade;
}

export function ticks(domain: Interval, count: number): number[] {
  const step = tickStep(domain, count);
  const first = Math.ceil(domain[0] / step - 1e-9);
  const last = Math.floor(domain[1] / step + 1e-9);
  return Array.from({ length: Math.max(0, last - first + 1) }, (_, k) =>
    Number(((first + k) * step).toPrecision(12)),
  );
}

/** Decimals that distinguish neighbouring ticks. */
export const tickDecimals = (step: number): number =>
  Math.max(0, -Math.floor(Math.log10(step) + 1e-9));

/** Least and greatest of all values; null where there is none. */
export function extentOf(lists: readonly Values[]): Interval | null {
  let [low, high] = [Number.POSITIVE_INFINITY, Number.NEGATIVE_INFINITY];
  for (const list of lists)
    for (const value of list)
      if (isNumber(value)) [low, high] = [Math.min(low, value), Math.max(high, value)];
  return low <= high ? [low, high] : null;
}

/** An interval a share wider on both sides, and never without width. */
export function widened([low, high]: Interval, share: number, least: number): Interval {
  const half = Math.max((high - low) / 2, least / 2);
  const middle = (low + high) / 2;
  return [middle - half * (1 + 2 * share), middle + half * (1 + 2 * share)];
}

const at = (x: number, y: number) => `${x.toFixed(2)},${y.toFixed(2)}`;

/** Runs of places where all lists have a number. */
export function runs(lists: readonly Values[]): number[][] {
  const found: number[][] = [];
  let run: number[] = [];
  for (let k = 0; k < (lists[0]?.length ?? 0); k += 1) {
    if (lists.every((list) => isNumber(list[k]))) run.push(k);
    else if (run.length > 0) {
      found.push(run);
      run = [];
    }
  }
  return run.length > 0 ? [...found, run] : found;
}

/** Path of a line, with a gap where nothing was measured. */
export function linePath(xs: Values, ys: Values, x: Scale, y: Scale): string {
  return runs([xs, ys])
    .map((run) => run.map((k) => at(x(xs[k] ?? 0), y(ys[k] ?? 0))))
    .map((points) => `M${points.join("L")}`)
    .join("");
}

/** Path of the band between two lines. */
export function bandPath(xs: Values, low: Values, high: Values, x: Scale, y: Scale): string {
  return runs([xs, low, high])
    .map((run) => {
      const above = run.map((k) => at(x(xs[k] ?? 0), y(high[k] ?? 0)));
      const below = run.map((k) => at(x(xs[k] ?? 0), y(low[k] ?? 0))).reverse();
      return `M${[...above, ...below].join("L")}Z`;
    })
    .join("");
}

/** Value of a line at a place on the x axis, between its corners; null in gaps and beyond its ends. */
export function valueAt(xs: Values, ys: Values, target: number): number | null {
  for (const run of runs([xs, ys]))
    for (const [i, k] of run.entries()) {
      const [x, y] = [xs[k] ?? 0, ys[k] ?? 0];
      if (x === target) return y;
      const before = run[i - 1];
      if (before === undefined) continue;
      const [x0, y0] = [xs[before] ?? 0, ys[before] ?? 0];
      if (x0 < target && target < x) return y0 + ((target - x0) / (x - x0)) * (y - y0);
    }
  return null;
}
