/** Features of a file on the local map. */

import { type GeoJsonFeature, type GeoJsonGeometry, moved } from "../../map/mars-geojson";
import type { Bounds } from "../../server/records";
import { type FileCrs, RefusedFile } from "./crs";

interface Collection extends GeoJsonGeometry {
  readonly geometries?: readonly GeoJsonGeometry[];
}

/** Parts of a geometry that are not collections. */
function parts(geometry: Collection | null): readonly GeoJsonGeometry[] {
  if (!geometry) return [];
  return geometry.geometries ? geometry.geometries.flatMap(parts) : [geometry];
}

/** Features with one geometry each, those without a place left out. */
export const placed = (features: readonly GeoJsonFeature[]): readonly GeoJsonFeature[] =>
  features.flatMap((feature) =>
    parts(feature.geometry).map((geometry) => ({ ...feature, geometry })),
  );

export function boundsOf(features: readonly GeoJsonFeature[]): Bounds {
  let [west, south, east, north] = [Infinity, Infinity, -Infinity, -Infinity];
  for (const { geometry } of features)
    moved(geometry?.coordinates ?? [0, 0], ([x = Number.NaN, y = Number.NaN]) => {
      [west, south] = [Math.min(west, x), Math.min(south, y)];
      [east, north] = [Math.max(east, x), Math.max(north, y)];
    });
  if (![west, south, east, north].every(Number.isFinite))
    throw new RefusedFile("it holds no feature with a place");
  return [west, south, east, north];
}

export const onMap = (
  features: readonly GeoJsonFeature[],
  { toMap }: Pick<FileCrs, "toMap">,
): readonly GeoJsonFeature[] =>
  features.map((feature) => ({
    ...feature,
    geometry: feature.geometry && {
      type: feature.geometry.type,
      coordinates: moved(feature.geometry.coordinates, toMap),
    },
  }));
