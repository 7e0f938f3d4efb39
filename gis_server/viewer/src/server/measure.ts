/** Measurements of the server on the ground: profiles, lines, areas, volumes and planes. */

import { of, post } from "./api";
import type { MapPoint } from "./records";

type Column = readonly (number | null)[];

export interface LayerUsed {
  readonly id: string;
  readonly kind: string;
  readonly digest: string;
  readonly cell_m: number | null;
}

/** Columns of stations along a line. */
export interface Profile {
  readonly length_m: number;
  readonly step_m: number;
  readonly slope_baseline_m: number;
  readonly distance_m: Column;
  readonly east: Column;
  readonly north: Column;
  readonly elevation_m: Column;
  readonly sigma_m: Column;
  readonly slope_deg: Column;
  readonly slope_sigma_deg: Column;
  readonly source: Column;
  readonly layers: readonly LayerUsed[];
}

export interface Rise {
  readonly map_distance_m: number;
  readonly straight_m: number;
  readonly rise_m: number;
  readonly sigma_rise_m: number;
  readonly slope_deg: number;
  readonly sigma_slope_deg: number;
  readonly azimuth_deg: number;
  readonly true_azimuth_deg: number;
}

export interface LineMeasured {
  readonly map_length_m: number;
  readonly surface_length_m: number;
  readonly measured_share: number;
  /** null: an end was not measured. */
  readonly ends: Rise | null;
  readonly layers: readonly LayerUsed[];
}

export interface AreaMeasured {
  readonly map_area_m2: number;
  readonly surface_area_m2: number | null;
  readonly perimeter_m: number;
  readonly elevation_mean_m: number | null;
  readonly elevation_min_m: number | null;
  readonly elevation_max_m: number | null;
  readonly sigma_elevation_mean_m: number | null;
  readonly sigma_elevation_min_m: number | null;
  readonly sigma_elevation_max_m: number | null;
  readonly measured_share: number;
  readonly layers: readonly LayerUsed[];
}

export interface VolumeMeasured {
  readonly above_m3: number;
  readonly sigma_above_m3: number;
  readonly below_m3: number;
  readonly sigma_below_m3: number;
  readonly net_m3: number;
  readonly sigma_net_m3: number;
  readonly map_area_m2: number;
  readonly measured_share: number;
  readonly highest_m: number;
  readonly sigma_highest_m: number;
  readonly lowest_m: number;
  readonly sigma_lowest_m: number;
  readonly base_elevation_m: number;
  readonly base_slope_deg: number;
  readonly sigma_base_slope_deg: number;
  readonly layers: readonly LayerUsed[];
}

export interface PlaneMeasured {
  readonly dip_deg: number;
  readonly sigma_dip_deg: number;
  readonly strike_deg: number | null;
  readonly sigma_strike_deg: number | null;
  readonly dip_direction_deg: number | null;
  readonly said_of_strike: string | null;
  readonly rms_m: number;
  readonly points: number;
  readonly layers: readonly LayerUsed[];
}

/** Statistics of a raster layer over a polygon, in the layer's own unit. */
export interface ZoneMeasured {
  readonly unit: string | null;
  readonly count: number;
  readonly measured_share: number;
  readonly mean: number | null;
  readonly std: number | null;
  readonly min: number | null;
  readonly max: number | null;
  /** Values by percentage. */
  readonly percentiles: Readonly<Record<string, number>>;
  readonly classes: readonly {
    readonly name: string;
    readonly area_m2: number;
    readonly share: number;
  }[];
  readonly layers: readonly LayerUsed[];
}

export type VolumeBase = "rim" | "lowest";

export const measuring = {
  profile: (mission: string, line: readonly MapPoint[], signal?: AbortSignal) =>
    post<Profile>(`${of(mission)}/profile`, { line }, signal),
  line: (mission: string, line: readonly MapPoint[]) =>
    post<LineMeasured>(`${of(mission)}/measure-line`, { line }),
  area: (mission: string, polygon: readonly MapPoint[]) =>
    post<AreaMeasured>(`${of(mission)}/measure-area`, { polygon }),
  volume: (mission: string, polygon: readonly MapPoint[], base: VolumeBase) =>
    post<VolumeMeasured>(`${of(mission)}/volume`, { polygon, base }),
  zone: (mission: string, polygon: readonly MapPoint[], layer: string) =>
    post<ZoneMeasured>(`${of(mission)}/zonal`, { polygon, layer }),
  plane: (mission: string, points: readonly MapPoint[]) =>
    post<PlaneMeasured>(`${of(mission)}/plane-fit`, { points }),
};
