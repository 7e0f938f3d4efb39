/**
 * The local map of a landing site, in OpenLayers and in Mars longitude and latitude.
 *
 * The map is the tangent plane at the landing point: orthographic on a sphere of the local radius R.
 * With D the vector (east, north) from the landing point (lon0, lat0), rho = |D|, c = asin(rho / R):
 *
 *     lat = asin(cos c sin lat0 + north sin c cos lat0 / rho)
 *     lon = lon0 + atan2(east sin c, rho cos lat0 cos c - north sin lat0 sin c)
 *
 * (Snyder, Map Projections - A Working Manual, USGS PP 1395, section 20.) proj4js does this, exactly as
 * PROJ does, for `+proj=ortho +R=`; it ignores `+k_0`, and that is refused here.
 *
 * OpenLayers believes that every plane is on the Earth: its point resolution, and so its scale bar, is
 * wrong by R_earth / R_mars = 1.88 unless the projection says that a map metre is a metre.
 */

import Projection from "ol/proj/Projection";
import proj4 from "proj4";
import type { LonLat, MapPoint, Mission } from "../server/records";

export class ProjectionError extends Error {
  override readonly name = "ProjectionError";
}

export interface LocalMap {
  readonly projection: Projection;
  /** Not a number on a map that is not tied to the lander. */
  toLonLat(point: MapPoint): LonLat;
  fromLonLat(lonLat: LonLat): MapPoint;
}

/** Radius of the sphere a proj4 string speaks of, metres. */
export function radiusOf(definition: string): number {
  const radius = Number(/\+R=([\d.eE+]+)/.exec(definition)?.[1]);
  if (!(radius > 0)) {
    throw new ProjectionError(`"${definition}" gives no radius: a local map needs +R=<metres>`);
  }
  if (/\+k(_0)?=/.test(definition)) {
    throw new ProjectionError(
      `"${definition}" scales the map, which the browser's proj4 ignores: put the scale into +R`,
    );
  }
  return radius;
}

export function localMap(mission: Pick<Mission, "mission" | "crs" | "tile_matrix_set">): LocalMap {
  const { proj4: definition } = mission.crs;
  const pair =
    definition === null
      ? null
      : proj4(`+proj=longlat +R=${radiusOf(definition)} +no_defs`, definition);
  return {
    projection: new Projection({
      code: `solmap:${mission.mission}`,
      units: "m",
      extent: [...mission.tile_matrix_set.extent],
      getPointResolution: (resolution) => resolution,
    }),
    toLonLat([east, north]) {
      const [lon = Number.NaN, lat = Number.NaN] = pair?.inverse([east, north]) ?? [];
      return [((lon % 360) + 360) % 360, lat];
    },
    fromLonLat([lon, lat]) {
      const [east = Number.NaN, north = Number.NaN] = pair?.forward([lon, lat]) ?? [];
      return [east, north];
    },
  };
}
