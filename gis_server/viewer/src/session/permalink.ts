/**
 * View and layers in the URL's fragment:
 * `#m=mer2&at=12.5,-3.25,0.02&on=scope/kind,scope/kind*0.6,scope/kind~slope::0:25&order=1&sol=156`.
 *
 * `at` is east, north, metres a pixel, and the turn of the map in degrees if it is turned. Layers are named without
 * their digest, so a link shows the newest product; behind `*` stands the opacity, behind another `*` how the
 * layer blends with what lies below, behind `~` the style. With `order=1` they
 * are listed as they lie, from the bottom to the top. All other keys belong to the part of the viewer that wrote them.
 */

import { blendNamed } from "../map/blending";
import { formatStyle, parseStyle } from "../map/raster-style";
import { formatSols, parseSols, type Sols } from "../map/sols";
import type { LinkedLayers } from "./layer-book";

export interface Place {
  readonly east: number;
  readonly north: number;
  readonly resolution: number;
  readonly rotationDeg: number;
}

export interface Permalink {
  readonly mission: string | null;
  readonly place: Place | null;
  /** The layers that are on; null if the link does not name them. */
  readonly on: LinkedLayers | null;
  /** Whether their order was chosen by hand. */
  readonly ordered: boolean;
  readonly sols: Sols;
  /** What the parts of the viewer keep, by their keys. */
  readonly more: ReadonlyMap<string, string>;
}

/** Parts of a link that cannot be read, verbatim. */
export function unreadable(fragment: string): readonly string[] {
  const query = new URLSearchParams(fragment.replace(/^#/, ""));
  const { place, sols } = parsePermalink(fragment);
  const isLost = (key: string) => (key === "at" && !place) || (key === "sol" && sols === null);
  return [...query].filter(([key]) => isLost(key)).map(([key, value]) => `${key}=${value}`);
}

const OWN = new Set(["m", "at", "on", "order", "sol"]);

const tidy = (value: number, decimals: number) => String(Number(value.toFixed(decimals)));

function parsePlace(text: string | null): Place | null {
  if (!text) return null;
  const [east, north, resolution, rotationDeg = 0] = text.split(",").map(Number);
  if (east === undefined || north === undefined || resolution === undefined) return null;
  if (![east, north, resolution, rotationDeg].every(Number.isFinite) || resolution <= 0)
    return null;
  return { east, north, resolution, rotationDeg };
}

function parseOn(text: string | null): LinkedLayers | null {
  if (text === null) return null;
  const entries = text.split(",").filter(Boolean);
  return new Map(
    entries.map((entry) => {
      const [named = "", style = ""] = entry.split("~");
      const [id = "", opacity, blend] = named.split("*");
      const value = opacity === undefined ? 1 : Number(opacity);
      const share = Number.isFinite(value) ? Math.min(1, Math.max(0, value)) : 1;
      return [id, { opacity: share, style: parseStyle(style), blend: blendNamed(blend) }] as const;
    }),
  );
}

function formatOn(on: LinkedLayers): string {
  const layers = [...on].map(([id, { opacity, style, blend }]) => {
    const strength = opacity < 1 || blend ? `*${tidy(opacity, 2)}` : "";
    const mode = blend ? `*${blend}` : "";
    const styleText = style ? formatStyle(style) : "";
    return `${id}${strength}${mode}${styleText && `~${styleText}`}`;
  });
  return layers.join(",");
}

export function parsePermalink(fragment: string): Permalink {
  const query = new URLSearchParams(fragment.replace(/^#/, ""));
  return {
    mission: query.get("m"),
    place: parsePlace(query.get("at")),
    on: parseOn(query.get("on")),
    ordered: query.get("order") === "1",
    sols: parseSols(query.get("sol")),
    more: new Map([...query].filter(([key]) => !OWN.has(key))),
  };
}

export function formatPermalink(link: Permalink): string {
  const { mission, place, on, sols } = link;
  const parts: string[] = [];
  if (mission) parts.push(`m=${encodeURIComponent(mission)}`);
  if (place) {
    const numbers = [tidy(place.east, 3), tidy(place.north, 3), tidy(place.resolution, 6)];
    if (Math.abs(place.rotationDeg) > 0.05) numbers.push(tidy(place.rotationDeg, 1));
    parts.push(`at=${numbers.join(",")}`);
  }
  if (on) parts.push(`on=${formatOn(on)}`);
  if (on && link.ordered) parts.push("order=1");
  if (sols !== null) parts.push(`sol=${formatSols(sols)}`);
  for (const [key, value] of link.more) parts.push(`${key}=${readable(value)}`);
  return `#${parts.join("&")}`;
}

/** Escaped, but for what a fragment may hold as it is. */
const readable = (value: string) =>
  encodeURIComponent(value).replace(/%(2C|3A|2F|3B)/g, (code) => decodeURIComponent(code));
