/** Places in the link: `12.5,-3.25;13,-3` are two, east and north in metres. */

import type { MapPoint } from "../server/records";

const MILLIMETRES = 3;

export const formatPoints = (points: readonly MapPoint[]): string =>
  points
    .map((point) => point.map((metres) => Number(metres.toFixed(MILLIMETRES))).join(","))
    .join(";");

/** Null for any other text. */
export function parsePoints(text: string): readonly MapPoint[] | null {
  const points = text.split(";").map((pair) => pair.split(",").map(Number));
  const isWhole = points.every((pair) => pair.length === 2 && pair.every(Number.isFinite));
  return isWhole ? points.map(([east = 0, north = 0]): MapPoint => [east, north]) : null;
}
