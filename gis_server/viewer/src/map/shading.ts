/**
 * Quantities from elevations, cell by cell, as in `photogrammetry/terrain/relief/slope.py`. With the gradient (g_e,
 * g_n) and a sun at azimuth A and elevation E:
 *
 *     slope   atan(hypot(g_e, g_n))            aspect   atan2(-g_e, -g_n), clockwise from north
 *     tilt    asin(-g_n / n)                   n        sqrt(1 + g_e^2 + g_n^2)
 *     relief  (sin E - cos E (g_e sin A + g_n cos A)) / n, 0 where that is negative
 */

import type { Quantity } from "./raster-style";
import { SIDE, type ValueTile } from "./value-tiles";

/** Direction of the sun, degrees; azimuth clockwise from north. */
export interface SunPlace {
  readonly azimuthDeg: number;
  readonly elevationDeg: number;
}

/** The sun of the hillshades that the server draws. */
export const CARTOGRAPHERS_SUN: SunPlace = { azimuthDeg: 315, elevationDeg: 45 };

const DEG = 180 / Math.PI;

/** A quantity on the 256 x 256 cells of a tile, NaN where not known; angles in degrees. */
export function quantityOf(tile: ValueTile, quantity: Quantity, sun: SunPlace): Float32Array {
  switch (quantity) {
    case "value":
    case "sigma":
    case "pose":
    case "observations":
    case "sigmas":
      return inner(tile);
    case "class": // means of several classes, which overviews hold, are none
      return inner(tile).map((value) => (Number.isInteger(value) ? value : Number.NaN));
    case "relief":
      return relief(tile, sun);
    case "slope":
      return derive(tile, (east, north) => Math.atan(Math.sqrt(east * east + north * north)) * DEG);
    case "aspect":
      return derive(tile, (east, north) => (Math.atan2(-east, -north) * DEG + 360) % 360);
    case "tilt":
      return derive(
        tile,
        (east, north) => Math.asin(-north / Math.sqrt(1 + east * east + north * north)) * DEG,
      );
    default:
      throw new Error(`unknown quantity ${JSON.stringify(quantity satisfies never)}`);
  }
}

function inner(tile: ValueTile): Float32Array {
  const found = new Float32Array(SIDE * SIDE);
  for (let row = 0; row < SIDE; row += 1) found.set(tile.row(row), row * SIDE);
  return found;
}

function derive(
  { gradients }: ValueTile,
  rule: (east: number, north: number) => number,
): Float32Array {
  const { east, north } = gradients;
  const found = new Float32Array(east.length);
  for (let at = 0; at < found.length; at += 1)
    found[at] = rule(east[at] as number, north[at] as number);
  return found;
}

function relief({ gradients }: ValueTile, { azimuthDeg, elevationDeg }: SunPlace): Float32Array {
  const { east, north } = gradients;
  const [azimuth, elevation] = [azimuthDeg / DEG, elevationDeg / DEG];
  const up = Math.sin(elevation);
  const toEast = Math.cos(elevation) * Math.sin(azimuth);
  const toNorth = Math.cos(elevation) * Math.cos(azimuth);
  const found = new Float32Array(east.length);
  for (let at = 0; at < found.length; at += 1) {
    const [e, n] = [east[at] as number, north[at] as number];
    const light = (up - e * toEast - n * toNorth) / Math.sqrt(1 + e * e + n * n);
    found[at] = light < 0 ? 0 : light;
  }
  return found;
}

/** Cell by cell difference; NaN where one of the two is not known. */
export function difference(a: ValueTile, b: ValueTile): Float32Array {
  const [first, second] = [inner(a), inner(b)];
  return first.map((value, at) => value - (second[at] as number));
}
