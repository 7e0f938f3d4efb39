/** Positions of the nodes of the network: stops as on the map, pairs by their viewing direction. */

import type { PairGraph, StopNode } from "../../server/network";

export interface Spot {
  readonly x: number;
  readonly y: number;
}

/** Side of the square that graphs are laid out in. */
export const SIDE = 1000;
const EDGE = 110;
const [INNER, OUTER] = [230, 420] as const;

/** Stops as on the map, north up, as large as fits. */
export function stopSpots(stops: readonly Pick<StopNode, "stop" | "place">[]): Map<string, Spot> {
  const [easts, norths] = [stops.map(({ place }) => place[0]), stops.map(({ place }) => place[1])];
  const [west, south] = [Math.min(...easts), Math.min(...norths)];
  const [width, height] = [Math.max(...easts) - west, Math.max(...norths) - south];
  const scale = (SIDE - 2 * EDGE) / Math.max(width, height, 1e-6);
  const [left, top] = [(SIDE - scale * width) / 2, (SIDE - scale * height) / 2];
  return new Map(
    stops.map(({ stop, place }) => {
      const [x, y] = [left + scale * (place[0] - west), SIDE - top - scale * (place[1] - south)];
      return [stop, { x, y }];
    }),
  );
}

/** Around a circle, at `azimuth` degrees clockwise from the top. */
const around = (azimuth: number, radius: number): Spot => {
  const turn = (azimuth * Math.PI) / 180;
  return { x: SIDE / 2 + radius * Math.sin(turn), y: SIDE / 2 - radius * Math.cos(turn) };
};

/**
 * The pairs of the stop on an inner circle, those of other stops on an outer one. Pairs that look the same way are moved
 * apart, in the order of their directions.
 */
export function pairSpots({ stop, pairs }: Pick<PairGraph, "stop" | "pairs">): Map<string, Spot> {
  const spots = new Map<string, Spot>();
  for (const [isOwn, radius] of [
    [true, INNER],
    [false, OUTER],
  ] as const) {
    const ring = pairs.filter((pair) => (pair.stop === stop) === isOwn);
    const turns = spread(ring.map(({ azimuth_deg }) => azimuth_deg));
    ring.forEach(({ id }, k) => spots.set(id, around(turns[k] ?? 0, radius)));
  }
  return spots;
}

/** Directions moved apart to at least a share of an even spacing; their order stays. */
export function spread(azimuths: readonly number[], share = 0.7): number[] {
  const least = (share * 360) / Math.max(azimuths.length, 1);
  const order = azimuths.map((_, k) => k).sort((a, b) => (azimuths[a] ?? 0) - (azimuths[b] ?? 0));
  const result = [...azimuths];
  let before = Number.NEGATIVE_INFINITY;
  for (const k of order) {
    before = Math.max(result[k] ?? 0, before + least);
    result[k] = before;
  }
  const first = result[order[0] ?? 0] ?? 0;
  const surplus = before + least - (first + 360);
  return surplus > 0 ? result.map((turn) => turn - surplus / 2) : result;
}

/** Width of an edge: grows with the logarithm of its ties. */
export const edgeWidth = (ties: number): number => 1.5 + 2.2 * Math.log2(1 + ties / 4);
