/** The scale bar: the longest of 1, 2, 5 times a power of ten that fits. */

import { metres } from "../page/format";

export interface ScaleBar {
  readonly metres: number;
  readonly px: number;
  readonly label: string;
}

/** Bar for a map of `resolution` metres a pixel, no longer than `maxPx`. */
export function scaleBar(resolution: number, maxPx: number): ScaleBar {
  const longest = resolution * maxPx;
  const decade = 10 ** Math.floor(Math.log10(longest) + 1e-12);
  const factor = [5, 2, 1].find((step) => step * decade <= longest * (1 + 1e-9)) ?? 1;
  const length = Number((factor * decade).toPrecision(1));
  return { metres: length, px: length / resolution, label: metres(length) };
}
