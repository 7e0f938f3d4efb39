/** Coordinates along the edges of the map: round metres whose labels do not overlap. */

/** The smallest of 1, 2, 5, 10 ... metres (or their fractions) above a length. */
export function roundStep(least: number): number {
  const power = 10 ** Math.floor(Math.log10(least));
  return (
    [1, 2, 5, 10].map((factor) => factor * power).find((step) => step >= least * (1 - 1e-9)) ??
    10 * power
  );
}

/** Least distance of two coordinates along an edge, pixels at 96 dots an inch. */
export const APART_PX = 80;

/** Whether north is up, as precisely as labels along an edge need it. */
export const isNorthUp = (rotationDeg: number) => Math.abs(rotationDeg) < 0.05;

export interface Tick {
  readonly px: number;
  readonly metres: number;
}

/**
 * Ticks along an edge of a given number of pixels, whose middle is at a coordinate, that grows by `perPx` a pixel; two
 * are at least `leastPx` apart.
 */
export function ticks(
  middle: number,
  perPx: number,
  lengthPx: number,
  leastPx: number,
): readonly Tick[] {
  const step = roundStep(leastPx * Math.abs(perPx));
  const [a, b] = [-1, 1].map((side) => middle + (side * perPx * lengthPx) / 2);
  const [low, high] = [Math.min(a ?? 0, b ?? 0), Math.max(a ?? 0, b ?? 0)];
  const first = Math.ceil(low / step);
  const count = Math.max(0, Math.floor(high / step) - first + 1);
  return Array.from({ length: count }, (_, k) => {
    const metres = Number(((first + k) * step).toPrecision(12));
    return { metres, px: lengthPx / 2 + (metres - middle) / perPx };
  });
}

/** "E 20 m" for 20 and "EW", "W 20 m" for -20. */
export function coordinateLabel(metres: number, [plus, minus]: "EW" | "NS"): string {
  return metres === 0 ? "0 m" : `${metres > 0 ? plus : minus} ${Math.abs(metres)} m`;
}
