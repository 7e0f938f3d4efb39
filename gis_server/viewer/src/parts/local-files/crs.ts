/**
 * The coordinate system of a file, and how its coordinates become metres of the local map.
 *
 * Longitude and latitude of the map are planetocentric. A system on an ellipsoid of semi-axes a and b has
 * planetographic latitudes: tan(centric) = (b / a)^2 tan(graphic).
 */

import proj4 from "proj4";
import type { LocalMap } from "../../map/projection";
import type { Bounds, LonLat, Mission } from "../../server/records";

/** A file cannot be put on the map; the message is for the person who dropped it. */
export class RefusedFile extends Error {
  override readonly name = "RefusedFile";
}

export interface FileCrs {
  /** How the coordinates were understood. */
  readonly title: string;
  /** Whether they are metres of the map already. */
  readonly isLocal: boolean;
  /** Whether they are longitude and latitude, with a period of 360. */
  readonly isDegrees: boolean;
  readonly toMap: (place: readonly number[]) => readonly number[];
  readonly fromMap: (place: readonly number[]) => readonly number[];
}

/** The map that coordinates are converted to. */
export interface Target {
  readonly mission: Pick<Mission, "crs" | "landing" | "bounds">;
  readonly local: Pick<LocalMap, "toLonLat" | "fromLonLat">;
}

const MARS_M = [3.3e6, 3.45e6] as const;
/** Semi-axes of IAU 2015, metres. */
const [IAU_A, IAU_B] = [3_396_190, 3_376_200];
/** The local map of a file is that of the page if their origins are within this distance, degrees. */
const SAME_DEG = 1e-6;
/** Degrees without a named system are of Mars within this distance of the landing site, degrees. */
const NEAR_DEG = 5;
/** Metres without a named system are of the map within this distance of its ground, metres. */
const NEAR_M = 20_000;

export const LOCAL: FileCrs = {
  title: "metres of the local map",
  isLocal: true,
  isDegrees: false,
  toMap: (place) => place,
  fromMap: (place) => place,
};

interface Parsed {
  readonly a: number;
  readonly b: number;
  readonly projName: string;
  readonly title?: string;
  readonly lat0?: number;
  readonly long0?: number;
}

const DEG = 180 / Math.PI;
const scaledTan = (lat: number, factor: number) => DEG * Math.atan(factor * Math.tan(lat / DEG));

/** Conversion by longitude and latitude, which `toLonLat` gives for the file's coordinates. */
function byDegrees(
  title: string,
  { mission, local }: Target,
  toLonLat: (place: readonly number[]) => LonLat,
  fromLonLat: (place: LonLat) => readonly number[],
): FileCrs {
  if (mission.crs.proj4 === null)
    throw new RefusedFile(
      `it is in ${title}, but this map is not tied to the lander: only metres of the map can be placed on it`,
    );
  return {
    title,
    isLocal: false,
    isDegrees: false,
    toMap: (place) => [...local.fromLonLat(toLonLat(place)), ...place.slice(2)],
    fromMap: ([east = 0, north = 0]) => fromLonLat(local.toLonLat([east, north])),
  };
}

/** Longitude and latitude of Mars; `squared` is (b / a)^2 where latitudes are planetographic. */
export function marsDegrees(title: string, target: Target, squared = 1): FileCrs {
  const placed = byDegrees(
    title,
    target,
    ([lon = 0, lat = 0]) => [lon, scaledTan(lat, squared)],
    ([lon, lat]) => [lon, scaledTan(lat, 1 / squared)],
  );
  return { ...placed, isDegrees: true };
}

/** Conversion by a definition in WKT or of PROJ. */
export function crsOf(named: string, target: Target): FileCrs {
  // The library has this projection under its short name only.
  const definition = named.replace(/(PROJECTION|METHOD)\["Orthographic"/i, '$1["ortho"');
  const { wkt, proj4: own } = target.mission.crs;
  if (named === wkt || named === own) return LOCAL;
  let parsed: Parsed;
  try {
    parsed = new proj4.Proj(definition) as unknown as Parsed;
  } catch {
    throw new RefusedFile(`its coordinate system is not understood: ${brief(definition)}`);
  }
  const { a, b, projName } = parsed;
  const title = titleOf(definition);
  if (!(a > MARS_M[0] && a < MARS_M[1]))
    throw new RefusedFile(
      `it is in ${title}, on a body of ${Math.round(a / 1000)} km radius; this map is of Mars`,
    );
  const squared = (b / a) ** 2;
  if (projName === "longlat") return marsDegrees(title, target, squared);
  if (projName === "ortho" && isOrigin(parsed, target)) return LOCAL;
  const pair = proj4(`+proj=longlat +a=${a} +b=${b} +no_defs`, definition);
  return byDegrees(
    title,
    target,
    ([x = 0, y = 0]) => {
      const [lon = Number.NaN, lat = Number.NaN] = pair.inverse([x, y]);
      return [lon, scaledTan(lat, squared)];
    },
    ([lon, lat]) => pair.forward([lon, scaledTan(lat, 1 / squared)]),
  );
}

function isOrigin({ lat0 = 0, long0 = 0 }: Parsed, { mission }: Target): boolean {
  const { latitude, longitude } = mission.landing;
  const turn = (((DEG * long0 - longitude + 180) % 360) + 360) % 360;
  return Math.abs(DEG * lat0 - latitude) < SAME_DEG && Math.abs(turn - 180) < SAME_DEG;
}

const brief = (text: string) => (text.length > 80 ? `${text.slice(0, 80)}…` : text);
const titleOf = (definition: string) =>
  /^\w+\["([^"]*)"/.exec(definition)?.[1] ?? brief(definition);

const NO_SYSTEM = /CRS:?84|EPSG:{1,2}4326$/i;
const IAU = /IAU[:_]{1,2}(?:2015)?:{1,2}(4990[0-2])$/i;

/** Conversion by the system that a file names; without one, or with the default of GeoJSON, by its numbers. */
export function crsNamed(name: string | null, bounds: Bounds, target: Target): FileCrs {
  if (name === null || NO_SYSTEM.test(name)) return crsByNumbers(bounds, target);
  const iau = IAU.exec(name)?.[1];
  if (iau === undefined) return crsOf(name, target);
  const title = `Mars longitude and latitude (IAU_2015:${iau})`;
  return marsDegrees(title, target, iau === "49901" ? (IAU_B / IAU_A) ** 2 : 1);
}

function crsByNumbers([west, south, east, north]: Bounds, target: Target): FileCrs {
  const { landing, bounds, crs } = target.mission;
  const [lon, lat] = [(west + east) / 2, (south + north) / 2];
  const turn = (((lon - landing.longitude + 180) % 360) + 360) % 360;
  const isNear = Math.abs(turn - 180) < NEAR_DEG && Math.abs(lat - landing.latitude) < NEAR_DEG;
  if (crs.proj4 !== null && isNear)
    return marsDegrees("Mars longitude and latitude (it names no system)", target);
  const [w, s, e, n] = bounds;
  const isOnGround =
    west > w - NEAR_M && east < e + NEAR_M && south > s - NEAR_M && north < n + NEAR_M;
  if (isOnGround) return { ...LOCAL, title: `${LOCAL.title} (it names no system)` };
  throw new RefusedFile(
    "it names no coordinate system of Mars, and its coordinates are neither degrees near the landing site nor metres near the mapped ground",
  );
}
