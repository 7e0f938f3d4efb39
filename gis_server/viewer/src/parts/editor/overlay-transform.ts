/**
 * How the orthophoto of one stop is placed over that of another: moved by east and north metres and turned about its
 * middle. A place p of the moved orthophoto lies at middle + R (p - middle) + shift; turns are clockwise, as azimuths.
 */

import type { MapPoint } from "../../server/records";

export interface Placement {
  readonly east: number;
  readonly north: number;
  readonly turnDeg: number;
}

export const AS_MAPPED: Placement = { east: 0, north: 0, turnDeg: 0 };

const turned = ([east, north]: MapPoint, degrees: number): MapPoint => {
  const angle = (degrees * Math.PI) / 180;
  const [c, s] = [Math.cos(angle), Math.sin(angle)];
  return [c * east + s * north, -s * east + c * north];
};

/** Position of a place of the moved orthophoto on the other one. */
export function placedAt(
  placement: Placement,
  middle: MapPoint,
  [east, north]: MapPoint,
): MapPoint {
  const [e, n] = turned([east - middle[0], north - middle[1]], placement.turnDeg);
  return [middle[0] + e + placement.east, middle[1] + n + placement.north];
}

/** The place of the moved orthophoto that lies at a place of the other one. */
export function under(placement: Placement, middle: MapPoint, [east, north]: MapPoint): MapPoint {
  const back: MapPoint = [east - placement.east - middle[0], north - placement.north - middle[1]];
  const [e, n] = turned(back, -placement.turnDeg);
  return [middle[0] + e, middle[1] + n];
}

export const movedBy = (placement: Placement, east: number, north: number): Placement => ({
  ...placement,
  east: placement.east + east,
  north: placement.north + north,
});

export const turnedBy = (placement: Placement, degrees: number): Placement => ({
  ...placement,
  turnDeg: placement.turnDeg + degrees,
});
