/** Data of the 3D view: models of the ground, stops, the rover and its cameras. */

import { get } from "./api";
import type { Bounds } from "./records";

/** East, north, up: metres of the mission's local map. */
export type Place3 = readonly [east: number, north: number, up: number];

export interface Model {
  readonly id: string;
  readonly scope: string;
  readonly kind: string;
  readonly digest: string;
  readonly title: string;
  readonly bounds: Bounds;
  /** Least and largest elevation, metres. */
  readonly range: readonly [least: number, most: number] | null;
  readonly sols: readonly number[];
  readonly open: string;
}

export interface SceneStop {
  readonly stop: string;
  readonly site: number;
  readonly drive: number;
  readonly sols: readonly number[];
  readonly held: boolean;
  readonly place: Place3;
  readonly telemetry: Place3;
  /** Rows of the rotation from the rover frame (forward, right, down) to the map. */
  readonly map_from_rover: readonly [Place3, Place3, Place3];
  readonly ellipsoid: {
    readonly semi_axes_m: Place3;
    readonly directions: readonly [Place3, Place3, Place3];
  };
}

/** The box around a rover in its own frame, metres from its origin. */
export interface Body {
  readonly back_m: number;
  readonly front_m: number;
  readonly half_width_m: number;
  /** Height of the deck above level ground. */
  readonly deck_m: number;
  /** Depth of level ground below the origin. */
  readonly ground_m: number;
}

export interface SceneStops {
  readonly network: string | null;
  readonly body: Body | null;
  readonly stops: readonly SceneStop[];
  /** Site frames (north, east, down) that are known, by telemetry. */
  readonly sites: readonly {
    readonly site: number;
    readonly place: Place3;
    readonly map_from_site: readonly [Place3, Place3, Place3];
  }[];
}

export interface SceneCamera {
  readonly image: string;
  readonly stop: string;
  readonly sol: number;
  readonly instrument: string;
  readonly eye: string;
  readonly partner: string | null;
  readonly centre: Place3;
  /** Unit directions: upper left, upper right, lower right, lower left. */
  readonly corners: readonly [Place3, Place3, Place3, Place3];
  /** Unit direction through the middle of the image. */
  readonly axis: Place3;
}

const of = (mission: string) => `api/missions/${encodeURIComponent(mission)}`;

export const sceneApi = {
  models: (mission: string, signal: AbortSignal) =>
    get<readonly Model[]>(`${of(mission)}/models`, signal),
  stops: (mission: string, signal: AbortSignal) =>
    get<SceneStops>(`${of(mission)}/scene/stops`, signal),
  cameras: async (mission: string, stop: string, signal: AbortSignal) => {
    const url = `${of(mission)}/scene/cameras?stop=${encodeURIComponent(stop)}`;
    return (await get<{ readonly cameras: readonly SceneCamera[] }>(url, signal)).cameras;
  },
};
