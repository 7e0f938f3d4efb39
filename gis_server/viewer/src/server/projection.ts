/** Projection between map and images by the server's camera models. Image points are of the image as stored. */

import { get, of, placeQuery, withQuery } from "./api";
import type { MapPoint } from "./records";

export interface PixelEllipse {
  readonly semi_major_px: number;
  readonly semi_minor_px: number;
  /** Angle of the major axis, from the direction of samples towards that of lines. */
  readonly angle_deg: number;
}

export interface Ground {
  readonly east: number;
  readonly north: number;
  readonly elevation_m: number;
  readonly sigma_east_m: number;
  readonly sigma_north_m: number;
  readonly sigma_up_m: number;
}

export type Sight = "visible" | "hidden" | "unknown";

export interface Seen {
  readonly image: string;
  readonly stop: string;
  readonly sol: number;
  readonly instrument: string;
  readonly eye: string;
  readonly sample: number;
  readonly line: number;
  readonly ellipse: PixelEllipse;
  readonly range_m: number;
  readonly incidence_deg: number | null;
  readonly sight: Sight;
  readonly told_by: string;
  /** Sample in the linearised image used for matching; null if the pair was not matched. */
  readonly linearised_sample: number | null;
  readonly linearised_line: number | null;
  readonly browse: string;
}

export interface GroundToImage {
  readonly ground: Ground;
  /** Images, those that see the place first, then by distance. */
  readonly images: readonly Seen[];
}

export interface ImageToGround {
  readonly image: string;
  readonly sample: number;
  readonly line: number;
  /** null: the ray meets no known ground. */
  readonly ground: Ground | null;
  readonly told_by: string;
}

interface PixelHere {
  readonly stored_sample: number;
  readonly stored_line: number;
}

export const projection = {
  /** The pixel of an image as stored, for one of the image as it is matched. */
  stored: async (
    image: string,
    [sample, line]: readonly [number, number],
    signal?: AbortSignal,
  ): Promise<readonly [number, number]> => {
    const query = { sample: sample.toFixed(3), line: line.toFixed(3), given: "linearised" };
    const path = `images/${encodeURIComponent(image)}/point`;
    const found = await get<PixelHere>(withQuery(path, query), signal);
    return [found.stored_sample, found.stored_line];
  },
  toImages: (mission: string, place: MapPoint, signal?: AbortSignal) =>
    get<GroundToImage>(withQuery(`${of(mission)}/ground-to-image`, placeQuery(place)), signal),
  toGround: (
    mission: string,
    image: string,
    [sample, line]: readonly [number, number],
    signal?: AbortSignal,
  ) =>
    get<ImageToGround>(
      withQuery(`${of(mission)}/image-to-ground`, {
        image,
        sample: sample.toFixed(3),
        line: line.toFixed(3),
      }),
      signal,
    ),
};
