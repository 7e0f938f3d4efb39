/** What the server measures on the ground: profiles, and later areas, volumes and planes. */

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

export const measuring = {
  profile: (mission: string, line: readonly MapPoint[], signal?: AbortSignal) =>
    post<Profile>(`${of(mission)}/profile`, { line }, signal),
};
