/** Entries that can be found by name, and the search in them. */

import { MAP_ONLY, readCoordinates, type References } from "../../map/coordinates";
import type { MapPoint } from "../../server/records";

/** Target of an entry. Stops are named by their scope. */
export type Goal =
  | { readonly to: "sol"; readonly sol: number }
  | { readonly to: "site"; readonly site: number }
  | { readonly to: "stop"; readonly stop: string }
  | { readonly to: "image"; readonly image: string; readonly stop: string }
  | { readonly to: "place"; readonly point: MapPoint };

export interface Entry {
  readonly title: string;
  readonly detail: string;
  /** Names in lower case. */
  readonly names: readonly string[];
  readonly goal: Goal;
}

export interface StopFacts {
  readonly stop: string;
  readonly site: number;
  readonly drive: number;
}

export interface ImageFacts extends StopFacts {
  readonly id: string;
  readonly sol: number;
  readonly instrument: string;
}

const MOST = 40;

const unique = <T>(values: readonly T[]) => [...new Set(values)];
const byNumber = (a: number, b: number) => a - b;

function stopEntry({ stop, site, drive }: StopFacts): Entry {
  return {
    title: `Site ${site} · drive ${drive}`,
    detail: "stop",
    names: [`${site}/${drive}`, `site ${site} drive ${drive}`, `stop ${site}/${drive}`, stop],
    goal: { to: "stop", stop },
  };
}

/** Everything that can be found, sols first and images last. */
export function entriesOf(
  sols: readonly number[],
  stops: readonly StopFacts[],
  images: readonly ImageFacts[],
): readonly Entry[] {
  const places = new Map([...images, ...stops].map((one) => [one.stop, one] as const));
  const known = [...places.values()].sort((a, b) => a.site - b.site || a.drive - b.drive);
  const days = unique([...sols, ...images.map(({ sol }) => sol)]).sort(byNumber);
  const sites = unique(known.map(({ site }) => site)).sort(byNumber);
  return [
    ...days.map(
      (sol): Entry => ({
        title: `Sol ${sol}`,
        detail: "sol",
        names: [`sol ${sol}`, `sol${sol}`, String(sol)],
        goal: { to: "sol", sol },
      }),
    ),
    ...sites.map(
      (site): Entry => ({
        title: `Site ${site}`,
        detail: "site",
        names: [`site ${site}`, `site${site}`],
        goal: { to: "site", site },
      }),
    ),
    ...known.map(stopEntry),
    ...images.map(
      (image): Entry => ({
        title: image.id,
        detail: `sol ${image.sol} · ${image.instrument}`,
        names: [image.id.toLowerCase()],
        goal: { to: "image", image: image.id, stop: image.stop },
      }),
    ),
  ];
}

/** 0: equal to its name; 1: a name begins with it; 2: a word of a name begins with it; 3: a name contains it. */
function fit(names: readonly string[], query: string): number | null {
  if (names.includes(query)) return 0;
  if (names.some((name) => name.startsWith(query))) return 1;
  if (names.some((name) => name.includes(` ${query}`))) return 2;
  return names.some((name) => name.includes(query)) ? 3 : null;
}

const places = (query: string, to: References): Entry[] =>
  readCoordinates(query, to).map(({ title, detail, point }) => ({
    ...{ title, detail, names: [] },
    goal: { to: "place", point },
  }));

/** The entries that match the text, the best first; `to` reads coordinates. */
export function find(
  entries: readonly Entry[],
  text: string,
  most = MOST,
  to: References = MAP_ONLY,
): readonly Entry[] {
  const query = text.trim().toLowerCase().replace(/\s+/g, " ");
  if (!query) return [];
  const ranks: Entry[][] = [[], [], [], []];
  for (const entry of entries) {
    const rank = fit(entry.names, query);
    if (rank !== null) ranks[rank]?.push(entry);
  }
  return [...places(query, to), ...ranks.flat()].slice(0, most);
}
