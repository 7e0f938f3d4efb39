/** Distances on the map. A map metre is a metre: lengths are planar, in the plane of the landing site. */

import { azimuthDeg, fixed, metres } from "../page/format";
import type { MapPoint } from "../server/records";

export interface Measured {
  readonly length_m: number;
  /** Of the last leg; null before there is one. */
  readonly leg_m: number | null;
  readonly azimuth_deg: number | null;
}

export function measure(line: readonly MapPoint[]): Measured {
  let length_m = 0;
  let leg_m: number | null = null;
  let azimuth_deg: number | null = null;
  for (let k = 1; k < line.length; k += 1) {
    const [from, to] = [line[k - 1], line[k]];
    if (!from || !to) continue;
    const [east, north] = [to[0] - from[0], to[1] - from[1]];
    const leg = Math.hypot(east, north);
    if (leg === 0) continue; // the pointer rests on the last vertex
    length_m += leg;
    leg_m = leg;
    azimuth_deg = azimuthDeg(east, north);
  }
  return { length_m, leg_m, azimuth_deg };
}

export function measuredText({ length_m, leg_m, azimuth_deg }: Measured): string {
  if (leg_m === null || azimuth_deg === null)
    return "click the first point; double-click ends, Esc stops";
  const leg = leg_m < length_m ? `, last leg ${metres(leg_m, 4)}` : "";
  return `${metres(length_m, 4)}${leg}, azimuth ${fixed(azimuth_deg, 1)}°`;
}

/** Area of a polygon on the map, square metres, by Gauss's formula; its corners may go either way round. */
export function polygonArea(corners: readonly MapPoint[]): number {
  const [e0, n0] = corners[0] ?? [0, 0]; // near the corners, where products lose no digits
  let twice = 0;
  corners.forEach(([east, north], k) => {
    const [e, n] = corners[(k + 1) % corners.length] ?? [east, north];
    twice += (east - e0) * (n - n0) - (e - e0) * (north - n0);
  });
  return Math.abs(twice) / 2;
}
