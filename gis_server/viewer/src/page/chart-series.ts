/** Series of a chart, the ends of its axes, its text for screen readers, and the cursor moves of keys. */

import { extentOf, type Interval, isNumber, type Values, valueAt, widened } from "./chart-scale";
import { measured } from "./format";

export interface Series {
  readonly name: string;
  readonly colour: string;
  readonly xs: Values;
  readonly ys: Values;
  /** Standard deviations: a band of one sigma. */
  readonly sigma?: Values;
  readonly isDashed?: boolean;
  readonly hasDots?: boolean;
}

export interface Axis {
  readonly title: string;
  readonly unit: string;
  /** Decimals of values at the cursor, where no standard deviation determines them. */
  readonly decimals: number;
}

export interface ChartOptions {
  readonly title: string;
  readonly summary: string;
  readonly x: Axis;
  readonly y: Axis;
  readonly series: readonly Series[];
  /** The cursor was moved to a place on the x axis; null: it left. */
  readonly onCursor?: (x: number | null) => void;
}

const FINE_STEPS = 200;

/** The lower (-1) or upper (1) edge of a series' band; the series itself where it has none. */
export const edge = ({ ys, sigma }: Series, sign: number): Values =>
  ys.map((y, k) => (isNumber(y) ? y + sign * (sigma?.[k] ?? 0) : null));

/** Intervals that hold all series with their bands. */
export function domains(series: readonly Series[]): { x: Interval; y: Interval } {
  const x = extentOf(series.map(({ xs }) => xs)) ?? [0, 1];
  const y = extentOf(series.flatMap((one) => [edge(one, -1), edge(one, 1)])) ?? [0, 1];
  return { x: x[0] === x[1] ? [x[0], x[0] + 1] : x, y: widened(y, 0.06, 0.01) };
}

/** The value of every series at a position on the x axis. */
export function valuesText({ series, y }: ChartOptions, x: number): string {
  const one = ({ name, xs, ys, sigma }: Series) => {
    const value = valueAt(xs, ys, x);
    const band = sigma && valueAt(xs, sigma, x);
    if (!isNumber(value)) return `${name} not measured`;
    return `${name} ${measured(value, y.unit, isNumber(band) ? band : null, 10 ** -y.decimals)}`;
  };
  return series.map(one).join(", ");
}

/** Position to which a key moves the cursor; undefined if it is not a key of the chart. */
export function keyed(
  key: string,
  current: number | null,
  [low, high]: Interval,
): number | null | undefined {
  const step = (high - low) / FINE_STEPS;
  switch (key) {
    case "ArrowRight":
    case "ArrowUp":
      return (current ?? low - step) + step;
    case "ArrowLeft":
    case "ArrowDown":
      return (current ?? high + step) - step;
    case "PageUp":
      return (current ?? low) + 10 * step;
    case "PageDown":
      return (current ?? high) - 10 * step;
    case "Home":
      return low;
    case "End":
      return high;
    default:
      return undefined;
  }
}
