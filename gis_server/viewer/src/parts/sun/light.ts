/**
 * Layers drawn for the sun, and their text in the link: `live=relief*0.6,shadow,tilt:5` and `sun=sol:156,14.5` or
 * `sun=315,45`.
 */

import type { SunPlace } from "../../map/shading";

export interface Light {
  /** Relief under the sun, over all rasters. */
  readonly relief: boolean;
  /** How strongly the relief covers what lies below it, 0 to 1. */
  readonly strength: number;
  readonly shadow: boolean;
  /** Only ground that tilts to the north by so many degrees and more; null: not shown. */
  readonly tiltDeg: number | null;
  /** Only ground that is so steep and steeper; null: not shown. */
  readonly slopeDeg: number | null;
}

export const DARK: Light = {
  relief: false,
  strength: 1,
  shadow: false,
  tiltDeg: null,
  slopeDeg: null,
};

export function formatLight({ relief, strength, shadow, tiltDeg, slopeDeg }: Light): string {
  const parts = [
    relief && (strength < 1 ? `relief*${tidy(strength, 2)}` : "relief"),
    shadow && "shadow",
    tiltDeg !== null && `tilt:${tiltDeg}`,
    slopeDeg !== null && `slope:${slopeDeg}`,
  ];
  return parts.filter(Boolean).join(",");
}

export function parseLight(text: string | null): Light {
  const parts = (text ?? "").split(",");
  const angle = (name: string) => {
    const found = parts.find((part) => part.startsWith(`${name}:`));
    const value = found === undefined ? Number.NaN : Number(found.slice(name.length + 1));
    return Number.isFinite(value) ? Math.min(89, Math.max(-89, value)) : null;
  };
  const relief = parts.find((part) => part === "relief" || part.startsWith("relief*"));
  const strength = Number(relief?.split("*")[1] ?? 1);
  return {
    relief: relief !== undefined,
    strength: strength >= 0 && strength <= 1 ? strength : 1,
    shadow: parts.includes("shadow"),
    tiltDeg: angle("tilt"),
    slopeDeg: angle("slope"),
  };
}

/** The sun by its place in the sky, or by sol and hour of local true solar time. */
export type Sky =
  | { readonly by: "hand"; readonly sun: SunPlace }
  | { readonly by: "time"; readonly sol: number; readonly hours: number };

const tidy = (value: number, decimals: number) => String(Number(value.toFixed(decimals)));

export function formatSky(sky: Sky): string {
  return sky.by === "time"
    ? `sol:${sky.sol},${tidy(sky.hours, 3)}`
    : `${tidy(sky.sun.azimuthDeg, 1)},${tidy(sky.sun.elevationDeg, 1)}`;
}

export function parseSky(text: string | null): Sky | null {
  const timed = /^sol:(\d+),(\d+(?:\.\d+)?)$/.exec(text ?? "");
  if (timed) {
    const [sol, hours] = [Number(timed[1]), Number(timed[2])];
    return hours <= 24 ? { by: "time", sol, hours } : null;
  }
  const [azimuthDeg, elevationDeg, ...rest] = (text ?? "").split(",").map(Number);
  if (!text || azimuthDeg === undefined || elevationDeg === undefined || rest.length > 0)
    return null;
  if (!Number.isFinite(azimuthDeg) || !(Math.abs(elevationDeg) <= 90)) return null;
  return { by: "hand", sun: { azimuthDeg: ((azimuthDeg % 360) + 360) % 360, elevationDeg } };
}

/** `14.5` as `14:30`. */
export function clock(hours: number): string {
  const minutes = Math.round(hours * 60) % 1440;
  const two = (value: number) => String(value).padStart(2, "0");
  return `${two(Math.floor(minutes / 60))}:${two(minutes % 60)}`;
}
