/** State of the comparison, and its text in the link. */

import { isElevation } from "../../map/raster-style";
import type { Layer } from "../../server/records";

export const MODES = ["swipe", "difference"] as const;
export type Mode = (typeof MODES)[number];

export interface Comparison {
  readonly mode: Mode;
  /** Ids of layers. */
  readonly a: string;
  readonly b: string;
  /** Where the divider stands, as a share of the map's width. */
  readonly at: number;
  /** Difference at the ends of the colours; null: what fits the view. */
  readonly most: number | null;
}

const tidy = (value: number) => String(Number(value.toPrecision(4)));

export function formatComparison({ mode, a, b, at, most }: Comparison): string {
  const last = mode === "swipe" ? tidy(at) : most === null ? "" : tidy(most);
  return [mode, a, b, last].join(",").replace(/,$/, "");
}

export function parseComparison(text: string | null): Comparison | null {
  const [name, a, b, last = ""] = (text ?? "").split(",");
  const mode = MODES.find((one) => one === name);
  if (!mode || !a || !b) return null;
  const value = last === "" ? Number.NaN : Number(last);
  const at = mode === "swipe" && value >= 0 && value <= 1 ? value : 0.5;
  return { mode, a, b, at, most: mode === "difference" && value > 0 ? value : null };
}

/** The proposed two layers: the uppermost of a kind, and another of that kind. */
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
