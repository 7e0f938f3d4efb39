/**
 * Position of the sun over a place, as in `photogrammetry/terrain/insolation/sun.py`: with the declination d of the season, the
 * planetographic latitude phi (up is the plumb line) and the hour angle w, 0 at true noon,
 *
 *     sin d = sin 25.19 sin Ls
 *     north = cos phi sin d - sin phi cos d cos w     east = -cos d sin w
 *     up    = sin phi sin d + cos phi cos d cos w
 */

import type { SunPlace } from "../../map/shading";
import { julianDate, julianOf, momentOf, seasonAt, solarDays } from "./mars-time";

const DEG = Math.PI / 180;
const SIN_OBLIQUITY = Math.sin(25.19 * DEG);
/** Polar by equatorial radius of Mars (IAU): 3376.20 by 3396.19 km. */
const FLATNESS = 3376.2 / 3396.19;

/** Degrees, planetocentric latitude, longitude to the east. */
export interface Site {
  readonly latitude: number;
  readonly longitude: number;
}

export function sunOver(site: Site, lsDeg: number, hours: number): SunPlace {
  const phi = Math.atan(Math.tan(site.latitude * DEG) / FLATNESS ** 2);
  const d = Math.asin(SIN_OBLIQUITY * Math.sin(lsDeg * DEG));
  const w = (hours - 12) * 15 * DEG;
  const north = Math.cos(phi) * Math.sin(d) - Math.sin(phi) * Math.cos(d) * Math.cos(w);
  const east = -Math.cos(d) * Math.sin(w);
  const up = Math.sin(phi) * Math.sin(d) + Math.cos(phi) * Math.cos(d) * Math.cos(w);
  return {
    azimuthDeg: (Math.atan2(east, north) / DEG + 360) % 360,
    elevationDeg: Math.asin(Math.min(1, Math.max(-1, up))) / DEG,
  };
}

/** A moment of a sol, and where the sun stands then. */
export interface Daylight {
  readonly moment: Date;
  readonly lsDeg: number;
  readonly sun: SunPlace;
}

/** `begin` is what `solsBegin` found; `hours` are of local true solar time. */
export function daylight(site: Site, begin: number, sol: number, hours: number): Daylight {
  const julian = julianOf(begin + sol + hours / 24, site.longitude);
  const { lsDeg } = seasonAt(julian);
  return { moment: momentOf(julian), lsDeg, sun: sunOver(site, lsDeg, hours) };
}

/** Position of the sun at a moment, and the local true solar time. */
export function sunAt(
  site: Site,
  moment: Date,
): { readonly sun: SunPlace; readonly hours: number } {
  const julian = julianDate(moment);
  const days = solarDays(julian, site.longitude);
  const hours = 24 * (days - Math.floor(days));
  return { sun: sunOver(site, seasonAt(julian).lsDeg, hours), hours };
}
