/** Features of the local map as GeoJSON for other programs. */

import type { Mission } from "../server/records";
import type { LocalMap } from "./projection";

export interface GeoJsonGeometry {
  readonly type: string;
  readonly coordinates: unknown;
}

export interface GeoJsonFeature {
  readonly type: "Feature";
  readonly id?: string | number;
  readonly geometry: GeoJsonGeometry | null;
  readonly properties: Readonly<Record<string, unknown>>;
}

/** CRS as in the server's downloads: longitude and latitude are those of Mars, IAU 2015. */
const MARS_CRS = {
  type: "name",
  properties: { name: "urn:ogc:def:crs:IAU:2015:49900" },
} as const;
/** Decimals of degrees: a tenth of a millimetre. */
const DECIMALS = 9;

type Nested = readonly (number | Nested)[];

/** Coordinates at any depth of nesting, each place changed by `move`. */
export function moved(coordinates: unknown, move: (place: readonly number[]) => unknown): unknown {
  const nested = coordinates as Nested;
  return typeof nested[0] === "number"
    ? move(nested as readonly number[])
    : (nested as readonly Nested[]).map((inner) => moved(inner, move));
}

/** Features in metres of the local map as a file in degrees of Mars; in metres where the map is not tied to the lander. */
export function marsGeojson(
  features: readonly GeoJsonFeature[],
  mission: Pick<Mission, "mission" | "crs">,
  local: Pick<LocalMap, "toLonLat">,
): string {
  const { proj4, wkt } = mission.crs;
  const degrees = ([east = 0, north = 0, ...up]: readonly number[]) => [
    ...local.toLonLat([east, north]).map((value) => Number(value.toFixed(DECIMALS))),
    ...up,
  ];
  const placed = ({ type, coordinates }: GeoJsonGeometry) => ({
    type,
    coordinates: moved(coordinates, degrees),
  });
  const collection = {
    type: "FeatureCollection",
    crs: proj4 === null ? { type: "name", properties: { name: wkt } } : MARS_CRS,
    "solmap:local_crs": proj4 ?? wkt,
    mission: mission.mission,
    features:
      proj4 === null
        ? features
        : features.map((one) => ({ ...one, geometry: one.geometry && placed(one.geometry) })),
  };
  return JSON.stringify(collection, null, 1);
}
