/** Manual ties before they are saved: predictions in other images, sub-pixel measurement, a trial adjustment. */

import { get, of, post, withQuery } from "./api";
import type { Ground, Seen } from "./projection";

export interface CurvePoint {
  readonly sample: number;
  readonly line: number;
  readonly range_m: number;
}

export interface Predicted extends Seen {
  readonly epipolar: readonly CurvePoint[];
}

export interface ImageToImage {
  readonly ground: Ground | null;
  readonly told_by: string;
  /** Images in which the place is visible come first. */
  readonly images: readonly Predicted[];
  readonly curves: Readonly<Record<string, readonly CurvePoint[]>>;
}

export interface PixelOf {
  readonly image: string;
  readonly sample: number;
  readonly line: number;
}

export interface Refined {
  readonly found: boolean;
  /** Why it was not found. */
  readonly said: string | null;
  readonly sample: number;
  readonly line: number;
  readonly moved_px: number;
  readonly sigma_px: number | null;
  readonly correlation: number | null;
}

export interface TieRequest {
  readonly action: "add";
  readonly first: PixelOf;
  readonly second: PixelOf;
  readonly sigma_px?: number;
}

export interface TieResidual {
  readonly tie: number;
  readonly status: "used" | "blunder" | "unused";
  readonly residual_px: number | null;
  readonly largest_standardised: number | null;
}

export interface Trial {
  readonly held_stop: string;
  readonly moved_stop: string;
  readonly change: {
    readonly east_m: number;
    readonly north_m: number;
    readonly up_m: number;
    readonly azimuth_deg: number;
    readonly sigma_east_m: number;
    readonly sigma_north_m: number;
  };
  readonly before: { readonly sigma0: number | null; readonly cross_site_ties: number };
  readonly after: { readonly sigma0: number | null; readonly cross_site_ties: number };
  readonly ties: readonly TieResidual[];
  readonly notes: readonly string[];
}

export const ties = {
  predict: (mission: string, { image, sample, line }: PixelOf, stop: string) =>
    get<ImageToImage>(
      withQuery(`${of(mission)}/image-to-image`, {
        image,
        sample: sample.toFixed(3),
        line: line.toFixed(3),
        stop,
      }),
    ),
  refine: (mission: string, first: PixelOf, second: PixelOf) =>
    post<Refined>(`${of(mission)}/refine`, { first, second }),
  trial: (mission: string, tieRequests: readonly TieRequest[]) =>
    post<Trial>(`${of(mission)}/preview-adjustment`, { ties: tieRequests }),
};
