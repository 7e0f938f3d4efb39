/** Numbers as a reader of maps expects them. */

import type { TraverseRow } from "../server/network";

const MINUS = "\u2212";

const signed = (text: string) => text.replace("-", MINUS);

/** A number with fixed decimals and a true minus sign; a dash for what was not measured. */
export function fixed(value: number | null | undefined, decimals: number): string {
  if (value === null || value === undefined || !Number.isFinite(value)) return "\u2013";
  const text = value.toFixed(decimals);
  return signed(Number(text) === 0 ? text.replace("-", "") : text);
}

/** A number with about `digits` significant digits, without exponent for everyday sizes. */
export function compact(value: number | null | undefined, digits = 4): string {
  if (value === null || value === undefined || !Number.isFinite(value)) return "\u2013";
  if (value === 0) return "0";
  const size = Math.abs(value);
  if (size >= 1e6 || size < 1e-4) return signed(value.toExponential(digits - 1));
  const decimals = Math.max(0, digits - 1 - Math.floor(Math.log10(size)));
  return signed(String(Number(value.toFixed(Math.min(decimals, 6)))));
}

/** Resolution of places that are held fixed: they have no standard deviation. */
export const HELD_M = 0.01;

const known = (sigma: number | null | undefined): sigma is number =>
  typeof sigma === "number" && Number.isFinite(sigma) && sigma > 0;

/**
 * Decimals down to the last digit that a standard deviation leaves: two digits of it where the first is 1 or 2, else
 * one (a simplification of the rule of the Particle Data Group). Negative where that digit stands before the point.
 */
export function decimalsOf(sigma: number): number {
  const [first = "", exponent = ""] = sigma.toExponential(1).split("e");
  return (first < "3" ? 1 : 0) - Number(exponent);
}

/** Decimals that distinguish lengths one cell or pixel apart; its size is in metres. */
export const decimalsFor = (resolution: number): number =>
  Math.max(0, -Number(resolution.toExponential().split("e")[1]));

function rounded(value: number | null | undefined, decimals: number): string {
  if (decimals >= 0) return fixed(value, Math.min(decimals, MOST_DECIMALS));
  const unit = 10 ** -decimals;
  return fixed(typeof value === "number" ? Math.round(value / unit) * unit : value, 0);
}
const MOST_DECIMALS = 15;

/** The standard deviation alone, with the digits that it has: `0.05 m`. */
export const sigmaText = (sigma: number | null | undefined, unit = "m"): string =>
  known(sigma) ? `${rounded(sigma, decimalsOf(sigma))}${unitSign(unit)}` : "\u2013";

/** Digits of a value alone: by its standard deviation, else by what was resolved, else three. */
export function digits(
  value: number | null | undefined,
  sigma?: number | null,
  resolution?: number | null,
): string {
  if (known(sigma)) return rounded(value, decimalsOf(sigma));
  return known(resolution) ? fixed(value, decimalsFor(resolution)) : compact(value, 3);
}

/**
 * A measured value with its standard deviation, both to the last digit that this leaves: `12.34 ± 0.05 m`. One that is
 * not known, or 0, is left out: then the digits are those of `resolution`, the cell or pixel that was measured on.
 */
export function measured(
  value: number | null | undefined,
  unit: string | null | undefined,
  sigma?: number | null,
  resolution?: number | null,
): string {
  if (value === null || value === undefined || !Number.isFinite(value)) return "\u2013";
  const plusMinus = known(sigma) ? ` \u00b1 ${digits(sigma, sigma)}` : "";
  return `${digits(value, sigma, resolution)}${plusMinus}${unitSign(unit)}`;
}

/** A length with the unit that keeps it short: 2 cm, 40 m, 1.2 km. */
export function metres(value: number, digits = 3): string {
  const size = Math.abs(value);
  if (size >= 1000) return `${compact(value / 1000, digits)} km`;
  if (size >= 1 || size === 0) return `${compact(value, digits)} m`;
  return size >= 0.01
    ? `${compact(value * 100, digits)} cm`
    : `${compact(value * 1000, digits)} mm`;
}

/** Unit as printed: degrees and metres by their signs. */
export function unitSign(unit: string | null | undefined): string {
  switch (unit) {
    case null:
    case undefined:
    case "":
    case "1":
      return "";
    case "\u00b0":
    case "degree":
    case "degrees":
    case "deg":
      return "\u00b0";
    case "metre":
    case "meter":
    case "m":
      return " m";
    case "Wh/m2/sol":
      return " Wh/m\u00b2 per sol";
    default:
      return ` ${unit}`;
  }
}

/** Latitude in degrees, as "14.5692° S". */
export const northOf = (lat: number): string =>
  `${Math.abs(lat).toFixed(4)}\u00b0 ${lat < 0 ? "S" : "N"}`;

/** Longitude in degrees, positive to the east, as "175.4729° E". */
export const eastOf = (lon: number): string =>
  `${Math.abs(lon).toFixed(4)}\u00b0 ${lon < 0 ? "W" : "E"}`;

/** Azimuth of a step, degrees clockwise from north, 0 to 360. */
export function azimuthDeg(east: number, north: number): number {
  return ((Math.atan2(east, north) * 180) / Math.PI + 360) % 360;
}

export function sols(values: readonly number[]): string {
  const sorted = [...new Set(values)].sort((a, b) => a - b);
  const first = sorted[0];
  const last = sorted.at(-1);
  if (first === undefined || last === undefined) return "\u2013";
  if (first === last) return `sol ${first}`;
  const gapless = last - first === sorted.length - 1;
  if (gapless || sorted.length > 4) return `sols ${first}\u2013${last}`;
  return `sols ${sorted.join(", ")}`;
}

/** `2026-11-21T01:02:03.4+00:00` as `2026-11-21 01:02`, UTC. */
export function time(iso: string | null | undefined): string {
  return iso ? iso.slice(0, 16).replace("T", " ") : "\u2013";
}

/** `mer2-site0010-drive0064` as `Site 10 · drive 64`; a scope without site and sol is the whole region. */
export function scopeTitle(scope: string): string {
  const stop = /site0*(\d+)-drive0*(\d+)/i.exec(scope);
  if (stop) {
    const place = `Site ${stop[1]} \u00b7 drive ${stop[2]}`;
    return scope.includes("-region-") ? `Merged map, ${place}` : place;
  }
  const sol = /sol0*(\d+)/i.exec(scope);
  return sol ? `Sol ${sol[1]}` : "Mission";
}

/** Percent of the distance, with the standard deviation of the metres. */
export const percentText = ({ percent, sigma_horizontal_m, distance_m }: TraverseRow): string =>
  percent === null ? "–" : `${digits(percent, (100 * sigma_horizontal_m) / distance_m, HELD_M)} %`;
