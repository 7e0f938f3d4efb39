/** Visibility: lines of sight and viewsheds. */

import { get, of, placeQuery, toQuery, withQuery } from "./api";
import type { LayerUsed } from "./measure";
import type { Bounds, MapPoint } from "./records";

type Column = readonly (number | null)[];

export interface SightLine {
  readonly sight: "visible" | "hidden" | "unknown";
  /** Least height of the line over known ground; negative below it. */
  readonly clearance_m: number | null;
  /** East, north and elevation of the ground that obstructs the line most. */
  readonly obstruction: readonly [east: number, north: number, elevation_m: number] | null;
  readonly obstruction_distance_m: number | null;
  /** Longest stretch of ground on the way that was not mapped. */
  readonly unseen_m: number;
  readonly map_distance_m: number;
  readonly distance_m: Column;
  readonly ground_m: Column;
  readonly line_m: Column;
  readonly layers: readonly LayerUsed[];
}

export interface Viewshed {
  readonly eye_elevation_m: number;
  readonly radius_m: number;
  readonly cell_m: number;
  readonly visible_m2: number;
  readonly hidden_m2: number;
  readonly unknown_m2: number;
  /** Bounds of the image. */
  readonly bounds: Bounds;
  readonly picture: string;
  readonly geotiff: string;
  readonly layers: readonly LayerUsed[];
}

export interface ViewshedQuery {
  readonly mast_m: number;
  readonly target_m: number;
  readonly radius_m: number;
}

export const sight = {
  line: (mission: string, eye: MapPoint, target: MapPoint, eye_m: number, target_m: number) =>
    get<SightLine>(
      withQuery(`${of(mission)}/line-of-sight`, {
        ...placeQuery(eye),
        ...toQuery(target),
        eye_m,
        target_m,
      }),
    ),
  viewshed: (mission: string, place: MapPoint, query: ViewshedQuery) =>
    get<Viewshed>(withQuery(`${of(mission)}/viewshed`, { ...placeQuery(place), ...query })),
};
