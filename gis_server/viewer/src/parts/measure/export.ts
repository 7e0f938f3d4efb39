/** Measurements as files: a table for spreadsheets, and GeoJSON in degrees of Mars. */

import { marsGeojson } from "../../map/mars-geojson";
import type { LocalMap } from "../../map/projection";
import { csvRow as row } from "../../page/csv";
import type { MapPoint, Mission } from "../../server/records";
import type { Found, Mode } from "./mode";

export interface Measurement {
  readonly number: number;
  readonly mode: Mode;
  readonly corners: readonly MapPoint[];
  readonly found: Found;
}

/** One line per quantity, and one per corner. */
export function measurementsCsv(all: readonly Measurement[]): string {
  const lines = all.flatMap(({ number, mode, corners, found }) => [
    ...found.quantities.map(({ name, value, word, sigma, unit }) =>
      row([
        number,
        mode.key,
        name,
        word ?? value,
        sigma,
        unit,
        found.layers.map(({ id }) => id).join(" "),
      ]),
    ),
    ...corners.flatMap(([east, north], k) => [
      row([number, mode.key, `east of point ${k + 1}`, east, null, "m", null]),
      row([number, mode.key, `north of point ${k + 1}`, north, null, "m", null]),
    ]),
  ]);
  return ["number,measured,quantity,value,sigma,unit,layers", ...lines, ""].join("\n");
}

/** The stations of all profiles. */
export function profilesCsv(all: readonly Measurement[]): string {
  const head =
    "number,distance_m,east,north,elevation_m,sigma_m,slope_deg,slope_sigma_deg,layer,digest";
  const lines = all.flatMap(({ number, found: { profile } }) =>
    (profile?.distance_m ?? []).map((distance, k) => {
      const layer = profile?.layers[profile.source[k] ?? -1];
      return row([
        number,
        distance,
        profile?.east[k],
        profile?.north[k],
        profile?.elevation_m[k],
        profile?.sigma_m[k],
        profile?.slope_deg[k],
        profile?.slope_sigma_deg[k],
        layer?.id,
        layer?.digest,
      ]);
    }),
  );
  return [head, ...lines, ""].join("\n");
}

function geometry({ shape }: Mode, places: readonly (readonly number[])[]) {
  switch (shape) {
    case "line":
      return { type: "LineString", coordinates: places };
    case "area":
    case "box":
      return { type: "Polygon", coordinates: [[...places, places[0]]] };
    default:
      return { type: "MultiPoint", coordinates: places };
  }
}

export function measurementsGeojson(
  all: readonly Measurement[],
  mission: Pick<Mission, "mission" | "crs">,
  local: Pick<LocalMap, "toLonLat">,
): string {
  const features = all.map(({ number, mode, corners, found }) => ({
    type: "Feature" as const,
    id: number,
    geometry: geometry(mode, corners),
    properties: {
      measured: mode.key,
      ...Object.fromEntries(
        found.quantities.flatMap(({ name, value, word, sigma, unit }) => [
          [unit ? `${name}, ${unit}` : name, word ?? value],
          ...(sigma === undefined ? [] : [[`sigma of ${name}, ${unit}`, sigma]]),
        ]),
      ),
      layers: found.layers.map(({ id, digest }) => `${id}/${digest}`),
      corners_east_north_m: corners,
    },
  }));
  return marsGeojson(features, mission, local);
}
