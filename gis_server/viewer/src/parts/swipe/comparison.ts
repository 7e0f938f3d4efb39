/** Default comparison. */

import { isElevation } from "../../map/raster-style";
import type { Layer } from "../../server/records";

/** The two layers that most likely are to be compared: what lies uppermost of a kind, and another of that kind. */
export function firstPair(
  shown: readonly Layer[],
  all: readonly Layer[],
): readonly [Layer, Layer] | null {
  const rasters = all.filter(({ type }) => type === "raster");
  const candidates = [
    ...shown.filter(({ type }) => type === "raster"),
    ...rasters.filter(isElevation),
  ];
  for (const a of candidates) {
    const b = rasters.find(({ id, kind }) => id !== a.id && kind === a.kind);
    if (b) return [a, b];
  }
  const [a, b] = [...shown, ...rasters].filter(({ type }) => type === "raster");
  return a && b && a.id !== b.id ? [a, b] : null;
}
