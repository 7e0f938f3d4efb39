/** Distances on the map. A map metre is a metre: lengths are planar, in the plane of the landing site. */

import { azimuthDeg, digits, metres } from "../page/format";
import type { MapPoint } from "../server/records";

export interface Measured {
  readonly length_m: number;
  /** Length of the last leg; null before there is one. */
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
    return "click the first point; double-click or Enter ends, Esc stops";
  const leg = leg_m < length_m ? `, last leg ${metres(leg_m)}` : "";
  return `${metres(length_m)}${leg}, azimuth ${digits(azimuth_deg, null, 0.1)}°`;
}

/** Area of a polygon on the map, square metres, by Gauss's formula, in either orientation. */
export function polygonArea(corners: readonly MapPoint[]): number {
  const [e0, n0] = corners[0] ?? [0, 0]; // near the corners, where products lose no digits
  let twice = 0;
  corners.forEach(([east, north], k) => {
    const [e, n] = corners[(k + 1) % corners.length] ?? [east, north];
    twice += (east - e0) * (n - n0) - (e - e0) * (north - n0);
  });
  return Math.abs(twice) / 2;
}

/** Standard deviation of a coordinate that is known to a cell: uniform within it. */
export const placeSigma = (cell_m: number): number => cell_m / Math.sqrt(12);

/** Standard deviation of the length of a line whose corners are each known to a cell, independent of each other. */
export function lengthSigma(line: readonly MapPoint[], cell_m: number): number {
  const legs = line.slice(1).map(([east, north], k) => {
    const [e, n] = line[k] ?? [east, north];
    const length = Math.hypot(east - e, north - n) || 1;
    return [(east - e) / length, (north - n) / length] as const;
  });
  const squares = line.map((_, k) => {
    const [before, after] = [legs[k - 1] ?? [0, 0], legs[k] ?? [0, 0]];
    return (before[0] - after[0]) ** 2 + (before[1] - after[1]) ** 2;
  });
  return placeSigma(cell_m) * Math.sqrt(squares.reduce((total, one) => total + one, 0));
}

/** Least standard deviation of an area that was counted in cells: of those that its outline, a circle's, divides. */
export const countedSigma = (area_m2: number, cell_m: number): number =>
  placeSigma(cell_m) * Math.sqrt(cell_m * Math.sqrt(4 * Math.PI * area_m2));

/**
 * Standard deviation of a polygon's area whose corners are each known to a cell of the raster they were placed on:
 * uniform within the cell, independent of each other. By the derivatives of Gauss's formula, half of the diagonal
 * between its neighbours for each corner.
 */
export function areaSigma(corners: readonly MapPoint[], cell_m: number): number {
  const squares = corners.map((_, k) => {
    const [before, after] = [corners.at(k - 1), corners[(k + 1) % corners.length]];
    return before && after ? (after[0] - before[0]) ** 2 + (after[1] - before[1]) ** 2 : 0;
  });
  const sum = squares.reduce((total, one) => total + one, 0);
  return (placeSigma(cell_m) * Math.sqrt(sum)) / 2;
}
