/** Images and classes drawn by the server, with other grey values or colours, or without some classes. */

import { legendQuery } from "./bands";
import type { Legend, RasterLayer } from "../server/records";
import { lookup, RAMPS } from "./ramps";
import { hasValues, isPlain, type RasterStyle } from "./raster-style";

/** Changes red, green, blue, opacity in place. */
export type Recolour = (pixels: Uint8ClampedArray) => void;

/** Shades of grey after stretch and gamma, by the shade before. */
export function shades({ low, high, gamma }: Pick<RasterStyle, "low" | "high" | "gamma">) {
  const [black, white] = [low ?? 0, high ?? 255];
  const span = Math.max(1, white - black);
  return Uint8ClampedArray.from({ length: 256 }, (_, grey) => {
    const share = Math.min(1, Math.max(0, (grey - black) / span));
    return Math.round(255 * share ** (1 / (gamma ?? 1)));
  });
}

function stretched(style: RasterStyle): Recolour {
  const table = shades(style);
  const ramp = style.ramp ? lookup(RAMPS[style.ramp]) : null;
  return (pixels) => {
    for (let at = 0; at < pixels.length; at += 4) {
      const grey = table[pixels[at] ?? 0] ?? 0;
      for (let channel = 0; channel < 3; channel += 1)
        pixels[at + channel] = ramp
          ? (ramp[4 * grey + channel] ?? 0)
          : (table[pixels[at + channel] ?? 0] ?? 0);
    }
  };
}

/** Classes do not blend in a tile: each colour is one of the legend or transparent. */
function without(classes: NonNullable<Legend["classes"]>, hidden: readonly number[]): Recolour {
  const colours = new Set(
    hidden.map((one) => Number.parseInt((classes[one]?.colour ?? "#").slice(1), 16)),
  );
  return (pixels) => {
    for (let at = 0; at < pixels.length; at += 4) {
      const [red = 0, green = 0, blue = 0] = pixels.subarray(at, at + 3);
      if (colours.has((red << 16) | (green << 8) | blue)) pixels[at + 3] = 0;
    }
  };
}

export const classesOf = (layer: RasterLayer) => layer.legend?.classes ?? [];
/** Whether its grey values can be stretched: an image, and not one of classes. */
export const isImagery = (layer: RasterLayer) =>
  !hasValues(layer) && classesOf(layer).length === 0 && legendQuery(layer) === null;

/** How a style changes a layer's tiles; null: not at all. */
export function recolouring(layer: RasterLayer, style: RasterStyle | null): Recolour | null {
  if (!style || isPlain(style) || hasValues(layer)) return null;
  if (isImagery(layer)) return stretched(style);
  return style.hidden.length > 0 ? without(classesOf(layer), style.hidden) : null;
}

/** Shades below and above which a share of the pixels lies on either side; null where there are none. */
export function percentiles(counts: readonly number[], share: number): [number, number] | null {
  const total = counts.reduce((sum, count) => sum + count, 0);
  if (total === 0) return null;
  const at = (target: number) => {
    let sum = 0;
    const found = counts.findIndex((count) => (sum += count) > target);
    return found < 0 ? 255 : found;
  };
  const [low, high] = [at(share * total), at((1 - share) * total - 1e-9)];
  return high > low ? [low, high] : [low, low + 1];
}

/** Number of pixels by shade. */
export function count(pixels: Uint8ClampedArray, into: number[]): void {
  for (let at = 0; at < pixels.length; at += 4) {
    const shade = pixels[at] ?? 0;
    if (pixels[at + 3]) into[shade] = (into[shade] ?? 0) + 1;
  }
}
