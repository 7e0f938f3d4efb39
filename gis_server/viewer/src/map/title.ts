/** The subject of a map: its mission, and the sols, sites and the landing site below. */

import type { Layer, Mission } from "../server/records";
import { areIn, type Sols, solsTitle } from "./sols";

export interface MapTitle {
  readonly title: string;
  /** Sols, sites and landing site. */
  readonly parts: readonly string[];
}

const SITE = /-site(\d+)-/;

/** Title for the layers of a mission, when only those of some sols are shown. */
export function titleOf(
  { title, landing }: Pick<Mission, "title" | "landing">,
  layers: readonly Pick<Layer, "scope" | "sols">[],
  range: Sols,
): MapTitle {
  const shown = layers.filter(({ sols }) => areIn(sols, range));
  const sols = shown.flatMap((layer) => layer.sols);
  const sites = shown.flatMap(({ scope }) => SITE.exec(scope)?.[1] ?? []).map(Number);
  const parts = [
    range || sols.length === 0
      ? solsTitle(range)
      : solsTitle([Math.min(...sols), Math.max(...sols)]),
    sites.length === 0 ? "" : sitesTitle(Math.min(...sites), Math.max(...sites)),
    landing.name,
  ];
  return { title, parts: parts.filter(Boolean) };
}

const sitesTitle = (first: number, last: number) =>
  first === last ? `site ${first}` : `sites ${first}–${last}`;
