/** What a measurement states, as quantities with unit and standard deviation, and how they are printed. */

import { compact, fixed, metres } from "../../page/format";
import { areaSigma } from "../../map/measure";
import type {
  AreaMeasured,
  LayerUsed,
  LineMeasured,
  PlaneMeasured,
  VolumeMeasured,
  ZoneMeasured,
} from "../../server/measure";
import type { MapPoint } from "../../server/records";

export type Unit = "m" | "m²" | "m³" | "°" | "%" | "h" | "";

const OWN_UNITS: Readonly<Record<string, Unit>> = { m: "m", degree: "°", metre: "m" };

export interface Quantity {
  readonly name: string;
  readonly value: number | null;
  /** What is told in the place of a number. */
  readonly word?: string;
  readonly sigma?: number | null;
  readonly unit: Unit;
}

const DECIMALS: Readonly<Record<Unit, number>> = {
  m: 3,
  "m²": 3,
  "m³": 3,
  "°": 2,
  "%": 0,
  h: 2,
  "": 0,
};

/** `12.346 ± 0.020 m`; a dash for what was not measured. */
export function quantityText({ value, word, sigma, unit }: Quantity): string {
  if (word) return word;
  if (value === null) return "–";
  const decimals = unit === "m²" && sigma ? decimalsOf(sigma) : DECIMALS[unit];
  const sign = unit === "°" ? "°" : unit ? ` ${unit}` : "";
  const plusMinus = sigma === null || sigma === undefined ? "" : ` ± ${fixed(sigma, decimals)}`;
  if (unit === "m" && !plusMinus && Math.abs(value) >= 1000) return metres(value, 7);
  if (unit.length === 2 && !plusMinus && value !== 0 && Math.abs(value) < 0.01)
    return `${compact(value, 3)}${sign}`;
  return `${fixed(value, decimals)}${plusMinus}${sign}`;
}

/** Decimals down to the first digit of a standard deviation. */
const decimalsOf = (sigma: number) =>
  Math.min(DECIMALS["m²"], Math.max(0, Math.ceil(-Math.log10(sigma))));

const measured = (share: number): Quantity => ({
  name: "ground measured",
  value: 100 * share,
  unit: "%",
});

export function lineQuantities(found: LineMeasured): Quantity[] {
  const { ends } = found;
  const length: Quantity[] = [
    { name: "length on the map", value: found.map_length_m, unit: "m" },
    { name: "length along the ground", value: found.surface_length_m, unit: "m" },
    measured(found.measured_share),
  ];
  if (!ends) return length;
  return [
    ...length,
    { name: "straight, in space", value: ends.straight_m, unit: "m" },
    { name: "rise", value: ends.rise_m, sigma: ends.sigma_rise_m, unit: "m" },
    { name: "slope", value: ends.slope_deg, sigma: ends.sigma_slope_deg, unit: "°" },
    { name: "azimuth on the map", value: ends.azimuth_deg, unit: "°" },
    { name: "azimuth from true north", value: ends.true_azimuth_deg, unit: "°" },
  ];
}

/** Areas are as good as the cells that their corners were placed on. */
const sigmaOf = (corners: readonly MapPoint[], [layer]: readonly LayerUsed[]) =>
  layer?.cell_m ? areaSigma(corners, layer.cell_m) : null;

export const areaQuantities = (found: AreaMeasured, corners: readonly MapPoint[]): Quantity[] => [
  {
    name: "area on the map",
    value: found.map_area_m2,
    sigma: sigmaOf(corners, found.layers),
    unit: "m²",
  },
  {
    name: "area of the ground",
    value: found.surface_area_m2,
    sigma: sigmaOf(corners, found.layers),
    unit: "m²",
  },
  { name: "perimeter", value: found.perimeter_m, unit: "m" },
  { name: "lowest ground", value: found.elevation_min_m, unit: "m" },
  { name: "mean elevation", value: found.elevation_mean_m, unit: "m" },
  { name: "highest ground", value: found.elevation_max_m, unit: "m" },
  measured(found.measured_share),
];

export const volumeQuantities = (
  found: VolumeMeasured,
  corners: readonly MapPoint[],
): Quantity[] => [
  { name: "above the base", value: found.above_m3, unit: "m³" },
  { name: "below the base", value: found.below_m3, unit: "m³" },
  { name: "net", value: found.net_m3, sigma: found.sigma_net_m3, unit: "m³" },
  {
    name: "area on the map",
    value: found.map_area_m2,
    sigma: sigmaOf(corners, found.layers),
    unit: "m²",
  },
  { name: "highest over the base", value: found.highest_m, unit: "m" },
  { name: "lowest over the base", value: found.lowest_m, unit: "m" },
  { name: "slope of the base", value: found.base_slope_deg, unit: "°" },
  measured(found.measured_share),
];

export const planeQuantities = (found: PlaneMeasured): Quantity[] => [
  { name: "strike", value: found.strike_deg, sigma: found.sigma_strike_deg, unit: "°" },
  { name: "dip", value: found.dip_deg, sigma: found.sigma_dip_deg, unit: "°" },
  { name: "dip direction", value: found.dip_direction_deg, unit: "°" },
  { name: "off the plane, rms", value: found.rms_m, unit: "m" },
  { name: "points", value: found.points, unit: "" },
];

/** Percentiles that a reader looks for, and what they are called. */
const TOLD_PERCENTILES = [
  ["5", "5 % are below"],
  ["50", "median"],
  ["95", "95 % are below"],
] as const;

export function zoneQuantities(found: ZoneMeasured): Quantity[] {
  const unit = OWN_UNITS[found.unit ?? ""] ?? "";
  if (found.classes.length > 0)
    return found.classes.map(({ name, share }) => ({ name, value: 100 * share, unit: "%" }));
  const one = (name: string, value: number | null | undefined): Quantity[] =>
    value === null || value === undefined ? [] : [{ name, value, unit }];
  return [
    ...one("mean", found.mean),
    ...one("standard deviation", found.std),
    ...one("least", found.min),
    ...TOLD_PERCENTILES.flatMap(([percent, name]) => one(name, percentile(found, percent))),
    ...one("greatest", found.max),
    { name: "cells", value: found.count, unit: "" },
    measured(found.measured_share),
  ];
}

/** The server names percentiles `5` or `5.0`. */
const percentile = ({ percentiles }: ZoneMeasured, percent: string) =>
  Object.entries(percentiles).find(([name]) => Number(name) === Number(percent))?.[1];

/** Terrain models that were asked, shortest way to say it. */
export const sourcesText = (layers: readonly LayerUsed[]): string =>
  layers.length === 0 ? "no terrain model" : layers.map(({ id }) => id).join(", ");
