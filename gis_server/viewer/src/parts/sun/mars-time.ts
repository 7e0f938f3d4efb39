/**
 * Season and solar time on Mars (Allison and McEwen 2000, Planet. Space Sci. 48, 215-235; constants and perturbations
 * of NASA GISS's Mars24).
 *
 * With t the days since J2000 (TT), the sun's mean anomaly M and the angle a of the fictitious mean sun:
 *
 *     M  = 19.3871 + 0.52402073 t          a = 270.3871 + 0.524038496 t
 *     C  = (10.691 + 3e-7 t) sin M + 0.623 sin 2M + 0.050 sin 3M + 0.005 sin 4M + 0.0005 sin 5M + PBS
 *     Ls = a + C
 *     E  = 2.861 sin 2Ls - 0.071 sin 4Ls + 0.002 sin 6Ls - C        equation of time, degrees
 *
 * and the mean solar time at the prime meridian, in sols, (JD_TT - 2405522.0028779) / 1.0274912517.
 */

const DEG = Math.PI / 180;
const J2000 = 2451545;
const EPOCH = 2405522.0028779;
/** Days of a sol. */
export const SOL_DAYS = 1.0274912517;
const UNIX_EPOCH = 2440587.5;
const DAY_MS = 86400000;

/** Amplitude in degrees, period in Julian years, phase in degrees: perturbations of the orbit by the planets. */
const PERTURBATIONS = [
  [0.0071, 2.2353, 49.409],
  [0.0057, 2.7543, 168.173],
  [0.0039, 1.1177, 191.837],
  [0.0037, 15.7866, 21.736],
  [0.0021, 2.1354, 15.704],
  [0.002, 2.4694, 95.528],
  [0.0018, 32.8493, 49.095],
] as const;

/** TT minus UTC from 1999 on, seconds, and the dates of later leap seconds. */
const TT_LESS_UTC_S = 64.184;
const ADDED = ["2006-01-01", "2009-01-01", "2012-07-01", "2015-07-01", "2017-01-01"].map((day) =>
  Date.parse(`${day}T00:00:00Z`),
);

/** Julian date in terrestrial time of a moment. */
export function julianDate(moment: Date): number {
  const ms = moment.getTime();
  const added = ADDED.filter((day) => ms >= day).length;
  return ms / DAY_MS + UNIX_EPOCH + (TT_LESS_UTC_S + added) / 86400;
}

export function momentOf(julian: number): Date {
  const rough = (julian - UNIX_EPOCH) * DAY_MS;
  const later = julianDate(new Date(rough)) - julian;
  return new Date(rough - later * DAY_MS);
}

export interface Season {
  /** Areocentric longitude of the sun, 0 to 360. */
  readonly lsDeg: number;
  /** Equation of time: true minus mean solar time, degrees. */
  readonly equationDeg: number;
}

export function seasonAt(julian: number): Season {
  const t = julian - J2000;
  const M = (19.3871 + 0.52402073 * t) * DEG;
  const planets = PERTURBATIONS.map(
    ([size, years, phase]) => size * Math.cos(((0.985626 * t) / years + phase) * DEG),
  ).reduce((sum, one) => sum + one, 0);
  const centre =
    (10.691 + 3e-7 * t) * Math.sin(M) +
    0.623 * Math.sin(2 * M) +
    0.05 * Math.sin(3 * M) +
    0.005 * Math.sin(4 * M) +
    0.0005 * Math.sin(5 * M) +
    planets;
  const ls = 270.3871 + 0.524038496 * t + centre;
  const L = ls * DEG;
  const equationDeg =
    2.861 * Math.sin(2 * L) - 0.071 * Math.sin(4 * L) + 0.002 * Math.sin(6 * L) - centre;
  return { lsDeg: ((ls % 360) + 360) % 360, equationDeg };
}

/** True solar days at an east longitude; the fraction is the time of the day, 0 at midnight. */
export function solarDays(julian: number, lonDeg: number): number {
  const { equationDeg } = seasonAt(julian);
  return (julian - EPOCH) / SOL_DAYS + (lonDeg + equationDeg) / 360;
}

/** Julian date of a number of true solar days at an east longitude. */
export function julianOf(days: number, lonDeg: number): number {
  let julian = EPOCH + (days - lonDeg / 360) * SOL_DAYS;
  for (let round = 0; round < 4; round += 1)
    julian += (days - solarDays(julian, lonDeg)) * SOL_DAYS;
  return julian;
}

/** Time, sol and local true solar time of an image's label. */
export interface Dated {
  readonly sol: number;
  readonly start_time: string | null;
  readonly local_solar_time: string | null;
}

/** `13:05:30` or `Sol-00025M13:05:30` in hours; null if it is not a time. */
export function hoursOf(text: string | null): number | null {
  const found = /(\d{1,2}):(\d{2}):(\d{2}(?:\.\d+)?)\s*$/.exec(text ?? "");
  if (!found) return null;
  const [hours = 0, minutes = 0, seconds = 0] = found.slice(1).map(Number);
  return hours + minutes / 60 + seconds / 3600;
}

export const utc = (text: string) => new Date(/(Z|[+-]\d\d:?\d\d)$/.test(text) ? text : `${text}Z`);

/** True solar days minus the mission's sols, from images that have both; null where there are none. */
export function solsBegin(images: readonly Dated[], lonDeg: number): number | null {
  const begins = images.flatMap(({ sol, start_time, local_solar_time }) => {
    const hours = hoursOf(local_solar_time);
    if (hours === null || !start_time) return [];
    const days = solarDays(julianDate(utc(start_time)), lonDeg) - sol - hours / 24;
    return Number.isFinite(days) ? [Math.round(days)] : [];
  });
  begins.sort((a, b) => a - b);
  return begins[Math.floor(begins.length / 2)] ?? null;
}
