/** A line on the map by the distance along it, and back. */

import type { MapPoint } from "../server/records";

export interface Along {
  readonly distance_m: number;
  /** Distance of the place from the line. */
  readonly off_m: number;
  readonly place: MapPoint;
}

const between = ([e0, n0]: MapPoint, [e1, n1]: MapPoint, share: number): MapPoint => [
  e0 + share * (e1 - e0),
  n0 + share * (n1 - n0),
];

/** Distance of every corner from the first, along the line. */
export function distances(line: readonly MapPoint[]): number[] {
  let sum = 0;
  return line.map(([east, north], k) => {
    const [e, n] = line[k - 1] ?? [east, north];
    sum += Math.hypot(east - e, north - n);
    return sum;
  });
}

/** The place at a distance along the line; distances beyond its ends give the end points. */
export function placeAt(line: readonly MapPoint[], distance_m: number): MapPoint | null {
  const at = distances(line);
  for (let k = 1; k < line.length; k += 1) {
    const [from, to, start, end] = [line[k - 1], line[k], at[k - 1] ?? 0, at[k] ?? 0];
    if (!from || !to || (distance_m > end && k < line.length - 1)) continue;
    const share = end > start ? (distance_m - start) / (end - start) : 0;
    return between(from, to, Math.min(1, Math.max(0, share)));
  }
  return line[0] ?? null;
}

/** The place of the line that is nearest to a point; null for a line without legs. */
export function nearestOn(line: readonly MapPoint[], [east, north]: MapPoint): Along | null {
  const at = distances(line);
  let best: Along | null = null;
  for (let k = 1; k < line.length; k += 1) {
    const [from, to] = [line[k - 1], line[k]];
    if (!from || !to) continue;
    const [de, dn] = [to[0] - from[0], to[1] - from[1]];
    const length2 = de * de + dn * dn;
    const raw = length2 > 0 ? ((east - from[0]) * de + (north - from[1]) * dn) / length2 : 0;
    const share = Math.min(1, Math.max(0, raw));
    const place = between(from, to, share);
    const off_m = Math.hypot(east - place[0], north - place[1]);
    if (best && best.off_m <= off_m) continue;
    best = { distance_m: (at[k - 1] ?? 0) + share * Math.sqrt(length2), off_m, place };
  }
  return best;
}
