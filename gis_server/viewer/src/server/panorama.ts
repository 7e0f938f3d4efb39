/** Panoramas of the stops: azimuth across, elevation down, both linear in pixels. */

import { get, of, withQuery } from "./api";
import type { Place3 } from "./scene";

export interface Panorama {
  readonly id: string;
  /** The stop. */
  readonly scope: string;
  readonly digest: string;
  readonly sols: readonly number[];
  readonly eye: string;
  readonly images: readonly string[];
  readonly centre: Place3;
  /** Azimuth of the left edge, degrees clockwise from north. */
  readonly west_deg: number;
  /** Elevation of the upper edge, degrees above the horizon. */
  readonly top_deg: number;
  readonly cell_deg: number;
  readonly rows: number;
  readonly cols: number;
  /** Median shift between neighbouring images, pixels. */
  readonly registration_px: number | null;
  readonly tiles: string;
  readonly tile_size: number;
  readonly max_zoom: number;
  readonly download: string;
}

export interface DirectionSeen {
  /** Ground seen; null in the sky and on ground outside all terrain models. */
  readonly ground: {
    readonly east: number;
    readonly north: number;
    readonly up: number;
    readonly distance_m: number;
  } | null;
  readonly shown: {
    readonly image: string;
    readonly sample: number | null;
    readonly line: number | null;
  } | null;
}

export interface PlaceSeen {
  readonly azimuth_deg: number;
  readonly elevation_deg: number;
  readonly distance_m: number;
  readonly inside: boolean;
  /** Whether nearer ground hides it; null: unknown. */
  readonly hidden: boolean | null;
}

const urlOf = (mission: string, { scope, digest }: Panorama, what: string) =>
  `${of(mission)}/panoramas/${encodeURIComponent(scope)}/${digest}/${what}`;

export const panoramaApi = {
  all: (mission: string, signal?: AbortSignal) =>
    get<readonly Panorama[]>(`${of(mission)}/panoramas`, signal),
  direction: (
    mission: string,
    panorama: Panorama,
    [azimuth, elevation]: readonly [number, number],
    signal?: AbortSignal,
  ) =>
    get<DirectionSeen>(
      withQuery(urlOf(mission, panorama, "direction"), { azimuth, elevation }),
      signal,
    ),
  place: (
    mission: string,
    panorama: Panorama,
    [east, north]: readonly [number, number],
    signal?: AbortSignal,
  ) => get<PlaceSeen>(withQuery(urlOf(mission, panorama, "place"), { east, north }), signal),
};
