/** Results of measurements as quantities with unit and standard deviation, and their text. */

import { kindTitle } from "../../map/kinds";
import { decimalsFor, measured, scopeTitle } from "../../page/format";
import { areaSigma, lengthSigma, placeSigma } from "../../map/measure";
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
  /** Text in the place of a number. */
  readonly word?: string;
  readonly sigma?: number | null;
  /** Resolution, where there is no standard deviation: the size of a cell. */
  readonly resolution?: number | null;
  readonly unit: Unit;
}

/** `12.35 ± 0.02 m`; a dash for what was not measured. */
export const quantityText = ({ value, word, sigma, resolution, unit }: Quantity): string =>
  word ?? measured(value, unit, sigma, resolution);

const measuredShare = (share: number): Quantity => ({
  name: "ground measured",
  value: 100 * share,
  resolution: 1,
  unit: "%",
});
/** Cell size of the finest model; null: no model was used. */
export const cellOf = ([layer]: readonly LayerUsed[]) => layer?.cell_m ?? null;
/** Decimals of lengths that were read from terrain models. */
export const decimalsOn = (layers: readonly LayerUsed[]) => decimalsFor(cellOf(layers) ?? 0.01);

export function lineQuantities(found: LineMeasured, corners: readonly MapPoint[]): Quantity[] {
  const { ends } = found;
  const cell = cellOf(found.layers);
  const sigma = cell && lengthSigma(corners, cell);
  const length: Quantity[] = [
    { name: "length on the map", value: found.map_length_m, sigma, unit: "m" },
    { name: "length along the ground", value: found.surface_length_m, sigma, unit: "m" },
    measuredShare(found.measured_share),
  ];
  if (!ends) return length;
  const across = Math.SQRT2 * placeSigma(cell ?? 0); // of one end from the other, in any direction
  const { map_distance_m, straight_m, rise_m, sigma_rise_m } = ends;
  const straight = Math.hypot(map_distance_m * across, rise_m * sigma_rise_m) / straight_m;
  const azimuth = ((across / map_distance_m) * 180) / Math.PI;
  return [
    ...length,
    { name: "straight, in space", value: straight_m, sigma: straight, unit: "m" },
    { name: "rise", value: rise_m, sigma: sigma_rise_m, unit: "m" },
    { name: "slope", value: ends.slope_deg, sigma: ends.sigma_slope_deg, unit: "°" },
    { name: "azimuth on the map", value: ends.azimuth_deg, sigma: azimuth, unit: "°" },
    { name: "azimuth from true north", value: ends.true_azimuth_deg, sigma: azimuth, unit: "°" },
  ];
}

/** The resolution of an area follows from the cells at its corners. */
const sigmaOf = (corners: readonly MapPoint[], layers: readonly LayerUsed[], of = areaSigma) => {
  const cell = cellOf(layers);
  return cell === null ? null : of(corners, cell);
};

const closed = (corners: readonly MapPoint[]) => [...corners, ...corners.slice(0, 1)];

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
  {
    name: "perimeter",
    value: found.perimeter_m,
    sigma: sigmaOf(closed(corners), found.layers, lengthSigma),
    unit: "m",
  },
  ...(
    [
      ["lowest ground", found.elevation_min_m, found.sigma_elevation_min_m],
      ["mean elevation", found.elevation_mean_m, found.sigma_elevation_mean_m],
      ["highest ground", found.elevation_max_m, found.sigma_elevation_max_m],
    ] as const
  ).map(([name, value, sigma]): Quantity => {
    return { name, value, sigma, resolution: cellOf(found.layers), unit: "m" };
  }),
  measuredShare(found.measured_share),
];

export const volumeQuantities = (
  found: VolumeMeasured,
  corners: readonly MapPoint[],
): Quantity[] => [
  { name: "above the base", value: found.above_m3, sigma: found.sigma_above_m3, unit: "m³" },
  { name: "below the base", value: found.below_m3, sigma: found.sigma_below_m3, unit: "m³" },
  { name: "net", value: found.net_m3, sigma: found.sigma_net_m3, unit: "m³" },
  {
    name: "area on the map",
    value: found.map_area_m2,
    sigma: sigmaOf(corners, found.layers),
    unit: "m²",
  },
  {
    name: "highest over the base",
    value: found.highest_m,
    sigma: found.sigma_highest_m,
    unit: "m",
  },
  { name: "lowest over the base", value: found.lowest_m, sigma: found.sigma_lowest_m, unit: "m" },
  {
    name: "slope of the base",
    value: found.base_slope_deg,
    sigma: found.sigma_base_slope_deg,
    unit: "°",
  },
  measuredShare(found.measured_share),
];

export const planeQuantities = (found: PlaneMeasured): Quantity[] => [
  { name: "strike", value: found.strike_deg, sigma: found.sigma_strike_deg, unit: "°" },
  { name: "dip", value: found.dip_deg, sigma: found.sigma_dip_deg, unit: "°" },
  {
    name: "dip direction",
    value: found.dip_direction_deg,
    sigma: found.sigma_strike_deg,
    unit: "°",
  },
  {
    name: "off the plane, rms",
    value: found.rms_m,
    sigma: found.rms_m / Math.sqrt(2 * Math.max(1, found.points - 3)),
    unit: "m",
  },
  { name: "points", value: found.points, resolution: 1, unit: "" },
];

/** Listed percentiles and their names. */
const LISTED_PERCENTILES = [
  ["5", "5 % are below"],
  ["50", "median"],
  ["95", "95 % are below"],
] as const;

export function zoneQuantities(found: ZoneMeasured): Quantity[] {
  const unit = OWN_UNITS[found.unit ?? ""] ?? "";
  if (found.classes.length > 0)
    return found.classes.map(({ name, share }) => ({
      ...{ name, value: 100 * share, resolution: 1 },
      unit: "%",
    }));
  // The spread of the values, not the cell size, determines their significant digits.
  const resolution = found.std ? found.std / 10 : null;
  const one = (name: string, value: number | null | undefined): Quantity[] =>
    value === null || value === undefined ? [] : [{ name, value, resolution, unit }];
  return [
    ...one("mean", found.mean),
    ...one("standard deviation", found.std),
    ...one("least", found.min),
    ...LISTED_PERCENTILES.flatMap(([percent, name]) => one(name, percentile(found, percent))),
    ...one("greatest", found.max),
    { name: "cells", value: found.count, resolution: 1, unit: "" },
    measuredShare(found.measured_share),
  ];
}

/** The server names percentiles `5` or `5.0`. */
const percentile = ({ percentiles }: ZoneMeasured, percent: string) =>
  Object.entries(percentiles).find(([name]) => Number(name) === Number(percent))?.[1];

/** Terrain models that were used, by kind. */
export function sourcesText(layers: readonly LayerUsed[]): string {
  if (layers.length === 0) return "no terrain model";
  const kinds = new Set(layers.map(({ kind }) => kindTitle(kind)));
  const of = (title: string) => layers.filter(({ kind }) => kindTitle(kind) === title);
  return [...kinds]
    .map(
      (title) =>
        `${title}: ${of(title)
          .map(({ id }) => scopeTitle(id))
          .join("; ")}`,
    )
    .join("; ");
}
