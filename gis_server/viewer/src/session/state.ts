/**
 * State of the viewer: one record, and how each of its fields is written in the URL's fragment,
 * `#m=MER2&at=12.5,-3.25,0.02&on=scope/kind*0.6&tab=sun`. Keys of the link are the names of the fields.
 *
 * Layers are named without their digest, so that a link shows the newest product. A pane is open while its field is not
 * null; `panes` is where the open ones are.
 */

import {
  as,
  type Broken,
  choice,
  type Codec,
  type Field,
  initially,
  list,
  maybe,
  number,
  or,
  record,
  significant,
  tuple,
  word,
} from "../codec";
import { BLEND_NAMES } from "../map/blending";
import type { LayerState } from "../map/layers";
import { linkedStyle } from "../map/raster-style";
import type { SunPlace } from "../map/shading";
import { linkedSols } from "../map/sols";
import type { Arrangement } from "../page/panes";
import { type Tab, TABS } from "../page/tabs";
import type { MapPoint } from "../server/records";
import type { Place3 } from "../server/scene";

export const MEASURES = [
  ...(["distance", "profile", "slope", "area", "volume", "plane"] as const),
  ...(["zone", "sight", "viewshed", "reach", "route"] as const),
];

export const COMPARISONS = ["swipe", "difference"] as const;
export const WAYS = ["anaglyph", "parallel", "crossed", "wiggle"] as const;
export const TABLES = ["stops", "images", "ties", "annotations"] as const;

/** The map: what is in its middle, metres a pixel, and its turn. */
export interface Place {
  readonly east: number;
  readonly north: number;
  readonly resolution: number;
  readonly rotationDeg: number;
}

/** How layers are shown that are on: from the bottom of the map to its top. */
export type LinkedLayers = ReadonlyMap<string, Pick<LayerState, "opacity" | "style" | "blend">>;

/** Filter of the listed layers. */
export interface LayerFilter {
  readonly words: string;
  /** Title of their kind; empty: all. */
  readonly kind: string;
  /** Instrument that photographed their stop; empty: all. */
  readonly instrument: string;
}

export interface Measured {
  readonly mode: (typeof MEASURES)[number];
  readonly corners: readonly MapPoint[];
  /** Numbers of its mode, in the order of `numberFields`; empty: the defaults. */
  readonly numbers: readonly number[];
  /** Layer of modes with `needsLayer`; null: the first one. */
  readonly layer: string | null;
}

/** The compared layers. */
export interface Comparison {
  readonly mode: (typeof COMPARISONS)[number];
  /** Ids of layers. */
  readonly a: string;
  readonly b: string;
  /** Position of the divider, as a share of the map's width. */
  readonly at: number;
  /** Difference at the ends of the colours; null: what fits the view. */
  readonly most: number | null;
}

/** The sun by its place in the sky, or by sol and hour of local true solar time. */
export type Sky =
  | { readonly by: "hand"; readonly sun: SunPlace }
  | { readonly by: "time"; readonly sol: number; readonly hours: number };

/** Layers of the sun. */
export interface Light {
  /** Relief under the sun, over all rasters. */
  readonly relief: boolean;
  /** How strongly the relief covers what lies below it, 0 to 1. */
  readonly strength: number;
  readonly shadow: boolean;
  /** Only ground that tilts to the north by so many degrees and more; null: not shown. */
  readonly tiltDeg: number | null;
  /** Only ground that is so steep and steeper; null: not shown. */
  readonly slopeDeg: number | null;
}

/** Visible part of an image: the image point in the middle of the pane, and screen pixels per image pixel. */
export interface ImageSight {
  readonly sample: number;
  readonly line: number;
  readonly scale: number;
}

/** A pair with the parallax that lies on the screen, pixels; null, and no name: as the pane opens. */
export interface StereoSight {
  readonly left: string;
  readonly way: (typeof WAYS)[number];
  readonly parallax: number | null;
  readonly sight: ImageSight | null;
}

/** Direction in the middle of a panorama, and the width that is seen; degrees. */
export interface PanoramaSight {
  readonly azimuth: number;
  readonly elevation: number;
  readonly width: number;
}

/** Eye and target in 3D. */
export interface Viewpoint {
  readonly from: Place3;
  readonly to: Place3;
}

/** Content of the 3D view: a kind of layer over the ground, a stop if one is chosen, whether the eye is at that stop. */
export interface Shown {
  readonly drape: string;
  readonly stop: string | null;
  readonly isStanding: boolean;
}

export const NOTHING_SHOWN: Shown = { drape: "", stop: null, isStanding: false };

/** Query of a table. */
export interface Query {
  /** Also columns that are out of view. */
  readonly hasAllColumns: boolean;
  readonly sort: string | null;
  readonly isDescending: boolean;
  /** All of these words occur in a row. */
  readonly words: string;
  /** Values that rows have in columns of choices. */
  readonly choices: ReadonlyMap<string, string>;
}
export interface Table extends Query {
  readonly subject: (typeof TABLES)[number];
}
export const ALL_ROWS: Query = {
  hasAllColumns: false,
  sort: null,
  isDescending: false,
  words: "",
  choices: new Map(),
};

const metres = number(3);
const NONE: readonly number[] = [];
const point: Codec<MapPoint> = tuple(",", metres, metres);
const text = or("", word);
const named = or(null, word);

const layer = record("~", {
  shown: record("*", {
    id: word,
    opacity: or(1, number(2, 0, 1)),
    blend: or(null, choice(BLEND_NAMES)),
  }),
  style: linkedStyle,
});
const layers = as(
  list(",", layer),
  (all): LinkedLayers =>
    new Map(all.map(({ shown: { id, ...shown }, style }) => [id, { ...shown, style }])),
  (on) =>
    [...on].map(([id, { opacity, blend, style }]) => ({ shown: { id, opacity, blend }, style })),
);

const comparison = as(
  record(",", {
    mode: choice(COMPARISONS),
    a: word,
    b: word,
    last: or(null, significant(4, 0)),
  }),
  ({ mode, a, b, last }): Comparison => {
    const isAt = mode === "swipe" && last !== null && last <= 1;
    return { mode, a, b, at: isAt ? last : 0.5, most: mode === "difference" ? last || null : null };
  },
  ({ mode, a, b, at, most }) => ({ mode, a, b, last: mode === "swipe" ? at : most }),
);

const byHand = record<SunPlace>(",", { azimuthDeg: number(1), elevationDeg: number(1, -90, 90) });
const byTime = record(",", { sol: number(0, 0), hours: number(3, 0, 24) });
const BY_TIME = "sol:";
const sky: Codec<Sky> = {
  read: (from, broken) => {
    if (from.startsWith(BY_TIME)) {
      const time = byTime.read(from.slice(BY_TIME.length), broken);
      return time && { by: "time", ...time };
    }
    const sun = byHand.read(from, broken);
    if (!sun) return undefined;
    const turns = Math.floor(sun.azimuthDeg / 360);
    return { by: "hand", sun: { ...sun, azimuthDeg: sun.azimuthDeg - 360 * turns } };
  },
  write: (one) => (one.by === "hand" ? byHand.write(one.sun) : `${BY_TIME}${byTime.write(one)}`),
};

export const DARK: Light = {
  relief: false,
  strength: 1,
  shadow: false,
  tiltDeg: null,
  slopeDeg: null,
};
/** `relief*0.6,shadow,tilt:5,slope:20`. */
const share = number(2, 0, 1);
const angle = number(1, -89, 89);
const light: Codec<Light> = {
  read: (from, broken) => {
    const read = (part: string): Partial<Light> | undefined => {
      const [name, value] = part.split(/[*:]/);
      if (part === "shadow") return { shadow: true };
      const strength = share.read(value ?? "1", broken);
      if (name === "relief") return strength === undefined ? undefined : { relief: true, strength };
      const degrees = angle.read(value ?? "", broken);
      if (degrees === undefined || !(name === "tilt" || name === "slope")) return undefined;
      return { [`${name}Deg`]: degrees };
    };
    const parts = list(",", { read, write: () => "" }).read(from, broken) ?? [];
    return Object.assign({}, DARK, ...parts) as Light;
  },
  write: ({ relief, strength, shadow, tiltDeg, slopeDeg }) =>
    [
      relief && (strength < 1 ? `relief*${share.write(strength)}` : "relief"),
      shadow && "shadow",
      tiltDeg !== null && `tilt:${angle.write(tiltDeg)}`,
      slopeDeg !== null && `slope:${angle.write(slopeDeg)}`,
    ]
      .filter(Boolean)
      .join(","),
};

const inImage: Codec<ImageSight | null> = or(
  null,
  record(",", { sample: number(1), line: number(1), scale: number(4, 1e-4, 64) }),
);

const [centimetres, degrees] = [number(2), number(2)];
const three = [centimetres, centimetres, centimetres] as const;
const look = as(
  tuple(",", ...three, ...three),
  ([a, b, c, d, e, f]): Viewpoint => ({ from: [a, b, c], to: [d, e, f] }),
  ({ from: [a, b, c], to: [d, e, f] }) => [a, b, c, d, e, f] as const,
);

/** `of=images&columns=all&sort=-sol&find=navcam&is.eye=left`. */
const IS = "is.";
const table: Codec<Table> = {
  read: (from, broken) => {
    const parts = new URLSearchParams(from);
    for (const key of parts.keys())
      if (!["of", "columns", "sort", "find"].includes(key) && !key.startsWith(IS)) broken(key);
    const subject = or(TABLES[0], choice(TABLES)).read(parts.get("of") ?? "", broken);
    const sort = parts.get("sort");
    const choices = [...parts].filter(([key]) => key.startsWith(IS));
    return (
      subject && {
        subject,
        hasAllColumns: parts.get("columns") === "all",
        sort: sort?.replace(/^-/, "") ?? null,
        isDescending: sort?.startsWith("-") ?? false,
        words: parts.get("find") ?? "",
        choices: new Map(choices.map(([key, value]) => [key.slice(IS.length), value] as const)),
      }
    );
  },
  write: ({ subject, hasAllColumns, sort, isDescending, words, choices }) => {
    const parts = new URLSearchParams({ of: subject });
    if (hasAllColumns) parts.set("columns", "all");
    if (sort) parts.set("sort", `${isDescending ? "-" : ""}${sort}`);
    if (words) parts.set("find", words);
    for (const [key, value] of choices) parts.set(`${IS}${key}`, value);
    return parts.toString();
  },
};

/** Open, without further choices. */
const open: Codec<true> = {
  read: (from) => (from === "" ? true : undefined),
  write: () => "",
};

const PANE_FIELDS = {
  image: maybe(record("~", { id: word, sight: inImage })),
  /** Stereo view, named by the left image of a pair. */
  stereo: maybe<StereoSight>(
    record("~", {
      left: text,
      way: or("anaglyph", choice(WAYS)),
      parallax: or(null, number(0)),
      sight: inImage,
    }),
  ),
  /** Panorama of a stop; without a stop, the nearest. */
  panorama: maybe(
    record("~", {
      stop: text,
      sight: or(
        null,
        record<PanoramaSight>(",", {
          azimuth: degrees,
          elevation: degrees,
          width: number(2, 0.01, 720),
        }),
      ),
    }),
  ),
  /** Seen from above where no eye is given. */
  view3d: maybe(record<{ readonly look: Viewpoint | null }>("~", { look: or(null, look) })),
  /** The image network: a stop for its pairs, or nothing for all stops. */
  network: maybe(text),
  /** The profile of a measurement, by its number in `measure`. */
  profile: maybe(
    record(":", {
      of: number(0, 1),
      shown: or("elevation", choice(["elevation", "slope"] as const)),
    }),
  ),
  /** The vertical profile of the traverse. */
  traverse: maybe(open),
  table: maybe(table),
} as const;
export type PaneName = keyof typeof PANE_FIELDS;
export const PANES = Object.keys(PANE_FIELDS) as readonly PaneName[];

const some = list(",", choice<string>(PANES));
const flag: Codec<boolean> = {
  read: (from) => from === "1" || undefined,
  write: (is) => (is ? "1" : ""),
};

const FIELDS = {
  /** The mission; none: the first. */
  m: maybe(word),
  at: maybe<Place>(
    record(",", {
      east: metres,
      north: metres,
      resolution: number(6, 1e-6),
      rotationDeg: or(0, number(1)),
    }),
  ),
  /** The layers that are on; null: those that are at first. */
  on: maybe(layers),
  /** Whether their order was chosen by hand. */
  order: initially(false, flag),
  /** Whether grid lines cross the map. */
  grid: initially(false, flag),
  sol: maybe(linkedSols),
  filter: initially<LayerFilter>(
    { words: "", kind: "", instrument: "" },
    record("~", { words: text, kind: text, instrument: text }),
  ),
  tab: initially<Tab>("point", choice(TABS)),
  /** The identified place, and the stop there if one was clicked. */
  pt: maybe(point),
  stop: maybe(word),
  /** The stop whose images are listed; null: all. */
  images: maybe(word),
  measure: initially<readonly Measured[]>(
    [],
    list(
      "/",
      record<Measured>(":", {
        mode: choice(MEASURES),
        corners: list(";", point, true),
        numbers: or(NONE, list(",", metres, true)),
        layer: or(null, { ...word, write: (id) => word.write(id).replaceAll("/", "%2f") }),
      }),
    ),
  ),
  /** The two solutions of the traverse. */
  solutions: initially(
    { solution: "latest", reference: "telemetry" },
    record(",", { solution: word, reference: word }),
  ),
  compare: maybe(comparison),
  /** Sun; null: in the north-west, as on printed maps. */
  sun: maybe(sky),
  live: initially(DARK, light),
  /** The terrain model that is lit; null: the widest. */
  ground: maybe(word),
  show3d: initially(
    NOTHING_SHOWN,
    record<Shown>("/", {
      drape: text,
      stop: named,
      isStanding: or(false, {
        read: (from) => from === "stand" || undefined,
        write: () => "stand",
      }),
    }),
  ),
  panes: initially<Arrangement>(
    { beside: [], below: [] },
    record("/", { beside: some, below: some }),
  ),
  ...PANE_FIELDS,
} as const;

type Fields = typeof FIELDS;
export type State = {
  readonly [K in keyof Fields]: Fields[K] extends Field<infer T> ? T : never;
};
export type Key = keyof State;

const KEYS = Object.keys(FIELDS) as readonly Key[];
const fieldOf = <K extends Key>(key: K) => FIELDS[key] as unknown as Field<State[K]>;

/** The text of a field; null: it is as at first. */
export const textOf = <K extends Key>(key: K, value: State[K]): string | null =>
  fieldOf(key).write(value);

/** The state in a link, and the parts of the link that are not known. */
export function parseLink(link: string): {
  readonly state: State;
  readonly unknown: readonly string[];
} {
  const query = new URLSearchParams(link.replace(/^#/, ""));
  const unknown = [...query.keys()].filter((key) => !KEYS.includes(key as Key));
  const valueOf = (key: Key) => {
    const from = query.get(key);
    const { first, read } = fieldOf(key);
    if (from === null) return first;
    const broken: Broken = (part) => unknown.push(`${key}=${part}`);
    const value = read(from, broken);
    if (value === undefined) broken(from);
    return value ?? first;
  };
  const state = Object.fromEntries(KEYS.map((key) => [key, valueOf(key)])) as State;
  return { state, unknown };
}

export function formatLink(state: State): string {
  const parts = KEYS.flatMap((key) => {
    const value = textOf(key, state[key]);
    return value === null ? [] : [`${key}=${readable(value)}`];
  });
  return `#${parts.join("&")}`;
}

/** Escaped, but for what a fragment may hold as it is. */
const readable = (value: string) =>
  encodeURIComponent(value).replace(/%(2C|3A|2F|3B)/g, (code) => decodeURIComponent(code));
