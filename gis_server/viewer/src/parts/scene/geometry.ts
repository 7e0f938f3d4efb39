/**
 * Geometry of the 3D view, without drawing: places are (east, north, up) in metres.
 *
 * A point x of the rover frame (forward, right, down) lies at R x + c on the map, with the rows of R that the server
 * gives and c the stop's place.
 */

import type { MapPoint } from "../../server/records";
import type { Body, Place3, SceneCamera, SceneStop } from "../../server/scene";

const radians = (degrees: number) => (degrees * Math.PI) / 180;

export const sum = (a: Place3, b: Place3, factor = 1): Place3 => [
  a[0] + factor * b[0],
  a[1] + factor * b[1],
  a[2] + factor * b[2],
];

/** Unit direction to the sun; azimuth clockwise from north. */
export function sunDirection(azimuthDeg: number, elevationDeg: number): Place3 {
  const [azimuth, elevation] = [radians(azimuthDeg), radians(elevationDeg)];
  const level = Math.cos(elevation);
  return [level * Math.sin(azimuth), level * Math.cos(azimuth), Math.sin(elevation)];
}

/** A direction of the rover frame on the map. */
export function turned({ map_from_rover }: Pick<SceneStop, "map_from_rover">, x: Place3): Place3 {
  const [east, north, up] = map_from_rover.map(
    (row) => row[0] * x[0] + row[1] * x[1] + row[2] * x[2],
  );
  return [east ?? 0, north ?? 0, up ?? 0];
}

/** A point of the rover frame on the map. */
export const onMap = (stop: SceneStop, x: Place3): Place3 => sum(stop.place, turned(stop, x));

/** Heading of the rover, degrees clockwise from north. */
export function headingDeg(stop: Pick<SceneStop, "map_from_rover">): number {
  const [east, north] = turned(stop, [1, 0, 0]);
  return ((Math.atan2(east, north) * 180) / Math.PI + 360) % 360;
}

/** Outline of the rover on the map: the box around its deck, with a notch that points ahead. */
export function outline(stop: SceneStop, body: Body): readonly MapPoint[] {
  const { back_m, front_m, half_width_m, deck_m, ground_m } = body;
  const down = ground_m - deck_m;
  const ring: readonly Place3[] = [
    [-back_m, -half_width_m, down],
    [front_m, -half_width_m, down],
    [front_m, -half_width_m / 4, down],
    [front_m + half_width_m / 4, 0, down],
    [front_m, half_width_m / 4, down],
    [front_m, half_width_m, down],
    [-back_m, half_width_m, down],
    [-back_m, -half_width_m, down],
  ];
  return ring.map((corner) => {
    const [east, north] = onMap(stop, corner);
    return [east, north];
  });
}

/** Segments (pairs of points) of a camera's pyramid of sight, `reach` metres long along its axis. */
export function pyramid(camera: SceneCamera, reach: number): readonly Place3[] {
  const { centre, axis } = camera;
  const corners = camera.corners.map((ray) => {
    const along = ray[0] * axis[0] + ray[1] * axis[1] + ray[2] * axis[2];
    return sum(centre, ray, reach / along);
  });
  return corners.flatMap((corner, k) => [centre, corner, corner, corners[(k + 1) % 4] ?? corner]);
}

/** A step around a target, keeping the distance or scaling it; z is up and the poles are never reached. */
export function orbited(
  [x, y, z]: Place3,
  turn: { readonly azimuth?: number; readonly elevation?: number; readonly scale?: number },
): Place3 {
  const distance = Math.hypot(x, y, z) * (turn.scale ?? 1);
  const azimuth = Math.atan2(y, x) + (turn.azimuth ?? 0);
  const most = Math.PI / 2 - 0.01;
  const elevation = Math.atan2(z, Math.hypot(x, y)) + (turn.elevation ?? 0);
  const held = Math.min(most, Math.max(-most, elevation));
  const level = distance * Math.cos(held);
  return [level * Math.cos(azimuth), level * Math.sin(azimuth), distance * Math.sin(held)];
}

/** The middle of bounds and elevations: what coordinates are drawn relative to, in whole metres; the lowest elevation. */
export function middle(
  boxes: readonly {
    readonly bounds: readonly [number, number, number, number];
    readonly range: readonly [number, number] | null;
  }[],
): { readonly origin: Place3; readonly size: number; readonly lowest: number } {
  const least = (values: readonly number[]) => Math.min(...values);
  const most = (values: readonly number[]) => Math.max(...values);
  if (boxes.length === 0) return { origin: [0, 0, 0], size: 50, lowest: 0 };
  const [west, south] = [
    least(boxes.map((b) => b.bounds[0])),
    least(boxes.map((b) => b.bounds[1])),
  ];
  const [east, north] = [most(boxes.map((b) => b.bounds[2])), most(boxes.map((b) => b.bounds[3]))];
  const ups = boxes.flatMap(({ range }) => range ?? []);
  const up = ups.length ? (least(ups) + most(ups)) / 2 : 0;
  return {
    origin: [Math.round((west + east) / 2), Math.round((south + north) / 2), Math.round(up)],
    size: Math.hypot(east - west, north - south),
    lowest: ups.length ? least(ups) : 0,
  };
}
