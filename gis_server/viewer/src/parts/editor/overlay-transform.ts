/**
 * Where the orthophoto of one stop is laid over that of another: moved by east and north metres and turned about its
 * middle. A place p of the moved orthophoto lies at middle + R (p - middle) + shift; turns are clockwise, as azimuths.
 */

import type { MapPoint } from "../../server/records";

export interface Laid {
  readonly east: number;
  readonly north: number;
  readonly turnDeg: number;
}

export const AS_MAPPED: Laid = { east: 0, north: 0, turnDeg: 0 };

const turned = ([east, north]: MapPoint, degrees: number): MapPoint => {
  const angle = (degrees * Math.PI) / 180;
  const [c, s] = [Math.cos(angle), Math.sin(angle)];
  return [c * east + s * north, -s * east + c * north];
};

/** Where a place of the moved orthophoto lies on the other one. */
export function laidAt(laid: Laid, middle: MapPoint, [east, north]: MapPoint): MapPoint {
  const [e, n] = turned([east - middle[0], north - middle[1]], laid.turnDeg);
  return [middle[0] + e + laid.east, middle[1] + n + laid.north];
}

/** The place of the moved orthophoto that lies at a place of the other one. */
export function under(laid: Laid, middle: MapPoint, [east, north]: MapPoint): MapPoint {
  const back: MapPoint = [east - laid.east - middle[0], north - laid.north - middle[1]];
  const [e, n] = turned(back, -laid.turnDeg);
  return [middle[0] + e, middle[1] + n];
}

export const movedBy = (laid: Laid, east: number, north: number): Laid => ({
  ...laid,
  east: laid.east + east,
  north: laid.north + north,
});

export const turnedBy = (laid: Laid, degrees: number): Laid => ({
  ...laid,
  turnDeg: laid.turnDeg + degrees,
});
