/** Driving: isochrones, and routes free of hazards. */

import { get, of, placeQuery, toQuery, withQuery } from "./api";
import type { LayerUsed } from "./measure";
import type { Bounds, MapPoint } from "./records";

type Column = readonly (number | null)[];

export interface Reachable {
  readonly farthest_m: number;
  readonly interval_m: number;
  readonly cell_m: number;
  readonly reached_m2: number;
  readonly longest_drive_m: number;
  readonly longest_drive_h: number;
  readonly speed_m_h: number;
  /** Bounds of the image. */
  readonly bounds: Bounds;
  readonly picture: string;
  readonly geotiff: string;
  readonly layers: readonly LayerUsed[];
}

export interface Route {
  /** Length along the ground. */
  readonly drive_m: number;
  readonly straight_m: number;
  readonly climb_m: number;
  readonly descent_m: number;
  readonly drive_h: number;
  readonly speed_m_h: number;
  readonly places: readonly MapPoint[];
  readonly distance_m: Column;
  readonly ground_m: Column;
  readonly layers: readonly LayerUsed[];
}

export const driving = {
  reach: (
    mission: string,
    place: MapPoint,
    query: { readonly farthest_m: number; readonly interval_m: number; readonly gap_m: number },
  ) => get<Reachable>(withQuery(`${of(mission)}/reach`, { ...placeQuery(place), ...query })),
  route: (mission: string, from: MapPoint, to: MapPoint, gap_m: number, farthest_m: number) =>
    get<Route>(
      withQuery(`${of(mission)}/route`, {
        ...placeQuery(from),
        ...toQuery(to),
        gap_m,
        farthest_m,
      }),
    ),
};
