/**
 * Directions and pixels of a panorama. In its plane x counts columns and y rows upwards, so that the upper left corner
 * is at (0, 0) and the lower right one at (cols, -rows).
 */

import { fixed } from "../../page/format";
import type { MapPoint } from "../../server/records";

/** Azimuth clockwise from north, elevation above the horizon; degrees. */
export type Direction = readonly [azimuthDeg: number, elevationDeg: number];
export type PlanePoint = readonly [x: number, y: number];

export interface AngleGrid {
  readonly west_deg: number;
  readonly top_deg: number;
  readonly cell_deg: number;
  readonly rows: number;
  readonly cols: number;
}

const CIRCLE = 360;
const POINTS = ["N", "NE", "E", "SE", "S", "SW", "W", "NW"] as const;
/** Steps of the axes, degrees. */
const STEPS = [0.1, 0.2, 0.5, 1, 2, 5, 10, 15, 30, 45];

const turned = (azimuthDeg: number) => ((azimuthDeg % CIRCLE) + CIRCLE) % CIRCLE;

export function directionAt(grid: AngleGrid, [x, y]: PlanePoint): Direction {
  return [turned(grid.west_deg + x * grid.cell_deg), grid.top_deg + y * grid.cell_deg];
}

export function planePoint(grid: AngleGrid, [azimuthDeg, elevationDeg]: Direction): PlanePoint {
  return [
    turned(azimuthDeg - grid.west_deg) / grid.cell_deg,
    (elevationDeg - grid.top_deg) / grid.cell_deg,
  ];
}

export const isInside = ({ rows, cols }: AngleGrid, [x, y]: PlanePoint): boolean =>
  x >= 0 && x <= cols && y <= 0 && y >= -rows;

/** The smallest step whose marks lie at least so many screen pixels apart. */
export function stepFor(degreesPerPixel: number, leastPx: number): number {
  return STEPS.find((step) => step / degreesPerPixel >= leastPx) ?? 90;
}

/** Whole multiples of a step between two angles. */
export function marks(from: number, to: number, step: number): number[] {
  const first = Math.ceil(from / step - 1e-9);
  const count = Math.max(0, Math.floor(to / step + 1e-9) - first + 1);
  return Array.from({ length: count }, (_, k) => (first + k) * step);
}

/** An azimuth as it stands on the axis: `90° E`. */
export function azimuthLabel(azimuthDeg: number, step: number): string {
  const azimuth = turned(azimuthDeg);
  const point = azimuth % 45 === 0 ? ` ${POINTS[azimuth / 45]}` : "";
  return `${fixed(azimuth, step < 1 ? 1 : 0)}\u00b0${point}`;
}

/** The end of a ray on the map. */
export function rayEnd([east, north]: MapPoint, azimuthDeg: number, lengthM: number): MapPoint {
  const turn = (azimuthDeg * Math.PI) / 180;
  return [east + lengthM * Math.sin(turn), north + lengthM * Math.cos(turn)];
}
