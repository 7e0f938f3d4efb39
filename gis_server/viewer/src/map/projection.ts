/**
 * The local map of a landing site, in OpenLayers and in Mars longitude and latitude.
 *
 * The map is the tangent plane at the landing point: orthographic on a sphere of the local radius R.
 * With D the vector (east, north) from the landing point (lon0, lat0), rho = |D|, c = asin(rho / R):
 *
 *     lat = asin(cos c sin lat0 + north sin c cos lat0 / rho)
 *     lon = lon0 + atan2(east sin c, rho cos lat0 cos c - north sin lat0 sin c)
 *
 *     east = R cos lat sin (lon - lon0)
 *     north = R (cos lat0 sin lat - sin lat0 cos lat cos (lon - lon0))
 *
 * (Snyder, Map Projections - A Working Manual, USGS PP 1395, section 20; PROJ's `+proj=ortho +R=`.) It is implemented
 * here because proj4js was a quarter of all that the browser fetched before it drew a map.
 *
 * OpenLayers assumes that every plane is on the Earth: its point resolution, and so its scale bar, is
 * wrong by R_earth / R_mars = 1.88 unless the projection states that a map metre is a metre.
 */

import Projection from "ol/proj/Projection";
import type { LonLat, MapPoint, Mission } from "../server/records";

const RADIAN = Math.PI / 180;
const NO_PLACE = [Number.NaN, Number.NaN] as const;

export class ProjectionError extends Error {
  override readonly name = "ProjectionError";
}

export interface LocalMap {
  readonly projection: Projection;
  /** NaN on a map that is not tied to the lander. */
  toLonLat(point: MapPoint): LonLat;
  fromLonLat(lonLat: LonLat): MapPoint;
}

/** Landing point in degrees and radius of the sphere in metres, of a PROJ string. */
export function planeOf(definition: string): { lon: number; lat: number; radius: number } {
  const number = (name: string) => {
    const value = Number(new RegExp(`\\+${name}=(\\S+)`).exec(definition)?.[1]);
    if (Number.isNaN(value)) throw new ProjectionError(`"${definition}" has no number as +${name}`);
    return value;
  };
  const [kind] = /(?<=\+proj=)\S+/.exec(definition) ?? [];
  const [unknown] = /\+(k|k_0|x_0|y_0)=\S+/.exec(definition) ?? [];
  if (kind !== "ortho" || unknown)
    throw new ProjectionError(
      `"${definition}" is not a plane that the viewer supports: +proj=ortho with +lat_0, +lon_0 and +R`,
    );
  return { lon: number("lon_0"), lat: number("lat_0"), radius: number("R") };
}

type Both = Pick<LocalMap, "toLonLat" | "fromLonLat">;

function orthographic(definition: string): Both {
  const { lon: lon0, lat: lat0, radius } = planeOf(definition);
  const [sin0, cos0] = [Math.sin(lat0 * RADIAN), Math.cos(lat0 * RADIAN)];
  return {
    toLonLat([east, north]) {
      const [x, y] = [east / radius, north / radius];
      const cosC = Math.sqrt(1 - x * x - y * y);
      const lon = lon0 + Math.atan2(x, cosC * cos0 - y * sin0) / RADIAN;
      return [((lon % 360) + 360) % 360, Math.asin(cosC * sin0 + y * cos0) / RADIAN];
    },
    fromLonLat([lon, lat]) {
      const [sin, cos] = [Math.sin(lat * RADIAN), Math.cos(lat * RADIAN)];
      const turn = (lon - lon0) * RADIAN;
      if (sin0 * sin + cos0 * cos * Math.cos(turn) < 0) return NO_PLACE; // beyond the horizon
      return [radius * cos * Math.sin(turn), radius * (cos0 * sin - sin0 * cos * Math.cos(turn))];
    },
  };
}

export function localMap(mission: Pick<Mission, "mission" | "crs" | "tile_matrix_set">): LocalMap {
  const { proj4: definition } = mission.crs;
  return {
    projection: new Projection({
      code: `solmap:${mission.mission}`,
      units: "m",
      extent: [...mission.tile_matrix_set.extent],
      getPointResolution: (resolution) => resolution,
    }),
    ...(definition === null
      ? { toLonLat: () => NO_PLACE, fromLonLat: () => NO_PLACE }
      : orthographic(definition)),
  };
}
