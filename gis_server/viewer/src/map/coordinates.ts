/**
 * Coordinates as people write them, and as they are shown.
 *
 * Understood are latitude and longitude (decimal, or degrees, minutes and seconds; N, S, E and W, longitude is east unless a
 * letter gives another direction), metres of the map, and metres of a site frame (`site 10: 3.2 -1.5`: x north, y east,
 * z down) or rover frame (`10/64: 3.2 -1.5`: x forward, y right, z down). Two plain numbers may be degrees or metres:
 * both readings are given, the degrees first where they lie near the mapped ground. What is shown can be read back.
 */

import { fixed, metres } from "../page/format";
import type { Bounds, LonLat, MapPoint } from "../server/records";
import type { Place3, SceneStops } from "../server/scene";
import type { LocalMap } from "./projection";

export type CoordinateFormat = "degrees" | "dms" | "west";

export const COORDINATE_FORMATS: readonly (readonly [CoordinateFormat, string])[] = [
  ["degrees", "decimal degrees"],
  ["dms", "deg, min, sec"],
  ["west", "west longitude"],
];

export interface Reading {
  /** The place as it was understood. */
  readonly title: string;
  /** How the numbers were interpreted, and the distance of the place from the mapped ground. */
  readonly detail: string;
  readonly point: MapPoint;
}

/** Reference systems that coordinates may be in. */
export interface References {
  readonly local: Pick<LocalMap, "toLonLat" | "fromLonLat"> | null;
  /** Bounds of the mapped ground. */
  readonly bounds: Bounds | null;
  readonly frames: Pick<SceneStops, "stops" | "sites"> | null;
}

export const MAP_ONLY: References = { local: null, bounds: null, frames: null };

/** Degrees within this distance of the mapped ground are listed before metres. */
const NEAR_M = 20_000;

interface Component {
  readonly value: number;
  readonly axis: "north" | "east" | null;
  /** Null: it may be either. */
  readonly unit: "degree" | "metre" | null;
}

type Ordered = readonly [north: number, east: number];

const AXES: Readonly<Record<string, Component["axis"]>> = {
  ...{ n: "north", s: "north", lat: "north", latitude: "north", north: "north", northing: "north" },
  ...{ e: "east", w: "east", lon: "east", long: "east", longitude: "east", east: "east" },
  ...{ easting: "east", south: "north", west: "east", x: "north", y: "east" },
};
const BACKWARDS = /^(s|w|south|west)$/;
const IN_DEGREES = /^(lat|latitude|lon|long|longitude)$/;
const IN_METRES = /^(m|metres?|meters?|northing|easting|x|y)$/;
const NUMBER = /[-+]?(?:\d+\.?\d*|\.\d+)/g;
const TOKEN = /[-+]?(?:\d+\.?\d*|\.\d+)|[a-z]+|[°'":]/g;

/** Lower case, with plain signs: `14d34m8s` becomes `14° 34' 8"`. */
function plain(text: string): string {
  return text
    .toLowerCase()
    .replace(/[\u2212\u2013]/g, "-")
    .replace(/''|[\u2033\u201d]/g, '"')
    .replace(/[\u2032\u2019]/g, "'")
    .replace(/\u00ba|(?<=\d)\s*(?:degrees|degree|deg)\b/g, "°")
    .replace(/(\d)\s*d\s*([\d.]+)\s*m(?:\s*([\d.]+)\s*s)?(?![a-z])/g, "$1° $2' $3")
    .replace(/\s+/g, " ")
    .trim();
}

/** One number with its axis and unit; null if it is not a number. */
function componentOf(text: string): Component | null {
  const tokens = text.match(TOKEN) ?? [];
  if (text.replace(TOKEN, "").replace(/[\s=]/g, "") !== "") return null;
  const words = tokens.filter((token) => /^[a-z]/.test(token));
  if (words.some((word) => !(word in AXES) && !IN_METRES.test(word))) return null;
  const numbers = tokens.filter((token) => /\d/.test(token));
  const [degrees = Number.NaN, minutes = 0, seconds = 0] = numbers.map(Number);
  const isAngle = /[°'"]|\d:/.test(text) || numbers.length > 1;
  if (numbers.length === 0 || numbers.length > 3) return null;
  if (![minutes, seconds].every((part) => part >= 0 && part < 60)) return null;
  const axes = new Set(words.flatMap((word) => AXES[word] ?? []));
  if (axes.size > 1) return null;
  const isMetre = words.some((word) => IN_METRES.test(word));
  if (isAngle && isMetre) return null;
  const size = Math.abs(degrees) + minutes / 60 + seconds / 3600;
  const isBack = words.some((word) => BACKWARDS.test(word)) || numbers[0]?.startsWith("-");
  return {
    value: isBack ? -size : size,
    axis: [...axes][0] ?? null,
    unit: isMetre
      ? "metre"
      : isAngle || words.some((word) => IN_DEGREES.test(word))
        ? "degree"
        : null,
  };
}

/** The two coordinates of a text: divided at its comma, its letters, or in the middle of its numbers. */
function halves(text: string): readonly [string, string] | null {
  const [one, other, ...rest] = text.split(/[,;]/).filter((part) => part.trim());
  if (rest.length > 0 || one === undefined) return null;
  if (other !== undefined) return [one, other];
  const numbers = [...text.matchAll(NUMBER)];
  const named = [...text.matchAll(/[a-z]+/g)].filter(([word]) => word in AXES);
  const [first, second] = named;
  const divide = (at: number): [string, string] => [text.slice(0, at), text.slice(at)];
  if (first && second) {
    const leads = first.index < (numbers[0]?.index ?? 0);
    return divide(leads ? second.index : first.index + first[0].length);
  }
  if (first) {
    const end = first.index + first[0].length;
    const isBetween = first.index > (numbers[0]?.index ?? 0) && end <= (numbers.at(-1)?.index ?? 0);
    if (isBetween) return text.charAt(end) === " " ? divide(end) : null; // names hold letters, too
  }
  const middle = numbers[numbers.length / 2];
  return middle ? divide(middle.index) : null;
}

/** The pair in the order north, east; `usualFirst` is the first one where no axis is named. */
function ordered(a: Component, b: Component, usualFirst: "north" | "east"): Ordered | null {
  if (a.axis !== null && a.axis === b.axis) return null;
  const first = a.axis ?? (b.axis === null ? usualFirst : b.axis === "north" ? "east" : "north");
  return first === "north" ? [a.value, b.value] : [b.value, a.value];
}

function distanceTo([east, north]: MapPoint, bounds: Bounds | null): number {
  if (!bounds) return 0;
  const outside = (value: number, least: number, most: number) =>
    Math.max(least - value, 0, value - most);
  return Math.hypot(outside(east, bounds[0], bounds[2]), outside(north, bounds[1], bounds[3]));
}

function detailOf(what: string, point: MapPoint, bounds: Bounds | null): string {
  const off = distanceTo(point, bounds);
  return off > 0 ? `${what}, ${metres(off, 2)} off the mapped ground` : what;
}

function degreeReading([lat, lon]: Ordered, { local, bounds }: References): Reading | null {
  if (!local || Math.abs(lat) > 90 || Math.abs(lon) > 360) return null;
  const east = ((lon % 360) + 360) % 360;
  const point = local.fromLonLat([east, lat]);
  // The map is a tangent plane: it has no places on the other side of the planet.
  if (!point.every(Number.isFinite)) return null;
  const [lonBack, latBack] = local.toLonLat(point);
  if (!(Math.abs(latBack - lat) < 1e-6 && Math.abs(lonBack - east) % 360 < 1e-6)) return null;
  return {
    title: lonLatText([east, lat], "degrees").join(", "),
    detail: detailOf("latitude, longitude", point, bounds),
    point,
  };
}

function metreReading([north, east]: Ordered, { bounds }: References): Reading {
  const point: MapPoint = [east, north];
  return {
    title: `east ${fixed(east, 2)} m, north ${fixed(north, 2)} m`,
    detail: detailOf("place on the map", point, bounds),
    point,
  };
}

interface Frame {
  readonly title: string;
  readonly place: Place3;
  /** Rows of the rotation from the frame to the map. */
  readonly rows: readonly [Place3, Place3, Place3];
}

const SITE = /^site (?:frame )?(\d+) ?[:,]? (.+)$/;
const ROVER = /^(?:rover |stop )?(?:(\d+) ?\/ ?(\d+)|site (\d+) ?[,·]? ?drive (\d+)) ?[:,]? (.+)$/;

function frameReading(text: string, { frames, bounds }: References): Reading | null | undefined {
  const rover = ROVER.exec(text);
  const site = rover ? null : SITE.exec(text);
  const rest = (rover?.[5] ?? site?.[2])?.replace(/\bm\b|[xyz=,;:]/g, " ").trim();
  if (rest === undefined || !/^[-+.\d\s]+$/.test(rest)) return undefined;
  const numbers = (rest.match(NUMBER) ?? []).map(Number);
  const [x = Number.NaN, y = Number.NaN, z = 0] = numbers;
  if (numbers.length < 2 || numbers.length > 3) return undefined;
  const [one, two] = [
    Number(rover?.[1] ?? rover?.[3] ?? site?.[1]),
    Number(rover?.[2] ?? rover?.[4]),
  ];
  const frame = rover
    ? framesOf(frames).find(({ title }) => title === roverTitle(one, two))
    : framesOf(frames).find(({ title }) => title === siteTitle(one));
  if (!frame) return null;
  const { place, rows } = frame;
  const along = (k: 0 | 1) => place[k] + rows[k][0] * x + rows[k][1] * y + rows[k][2] * z;
  const point: MapPoint = [along(0), along(1)];
  const given = numbers.map((value) => fixed(value, 2)).join(", ");
  return {
    title: `${frame.title}: ${given} m`,
    detail: detailOf(rover ? "forward, right" : "north, east of the site", point, bounds),
    point,
  };
}

const siteTitle = (site: number) => `site ${site}`;
const roverTitle = (site: number, drive: number) => `rover ${site}/${drive}`;

function framesOf(frames: References["frames"]): Frame[] {
  const sites = (frames?.sites ?? []).map(({ site, place, map_from_site: rows }) => ({
    title: siteTitle(site),
    place,
    rows,
  }));
  const stops = (frames?.stops ?? []).map(({ site, drive, place, map_from_rover: rows }) => ({
    title: roverTitle(site, drive),
    place,
    rows,
  }));
  return [...sites, ...stops];
}

/** The places that a text may mean, most probable first. */
export function readCoordinates(text: string, to: References): readonly Reading[] {
  const reading = plain(text);
  const inFrame = frameReading(reading, to);
  if (inFrame !== undefined) return inFrame ? [inFrame] : [];
  const parts = halves(reading);
  const [a, b] = [parts && componentOf(parts[0]), parts && componentOf(parts[1])];
  if (!a || !b) return [];
  const units = new Set([a.unit, b.unit]);
  if (units.has("degree") && units.has("metre")) return [];
  const asMetres = units.has("degree") ? null : ordered(a, b, "east");
  const metre = asMetres && metreReading(asMetres, to);
  const inDegrees = units.has("metre") ? [] : degreeOrders(a, b);
  const found = inDegrees.flatMap((pair) => degreeReading(pair, to) ?? []);
  const near = found.find(({ point }) => distanceTo(point, to.bounds) < NEAR_M);
  const degree = near ?? found[0];
  return [near, metre, degree].filter(
    (one, k, all): one is Reading => Boolean(one) && all.indexOf(one) === k,
  );
}

/** Latitude comes first; without letters it may also be second, as in GeoJSON. */
function degreeOrders(a: Component, b: Component): Ordered[] {
  const orders =
    a.axis === null && b.axis === null ? (["north", "east"] as const) : (["north"] as const);
  return orders.flatMap((first) => [ordered(a, b, first)].filter((pair) => pair !== null));
}

function sexagesimal(value: number, decimals: number): string {
  const unit = 10 ** decimals;
  const whole = Math.round(Math.abs(value) * 3600 * unit);
  const seconds = (whole % (60 * unit)) / unit;
  const minutes = Math.floor(whole / (60 * unit)) % 60;
  const [mm, ss] = [String(minutes), seconds.toFixed(decimals)];
  const width = decimals > 0 ? decimals + 3 : 2;
  return `${Math.floor(whole / (3600 * unit))}°${mm.padStart(2, "0")}′${ss.padStart(width, "0")}″`;
}

/** Latitude and longitude as text; `decimals` of a degree, those of a second are three fewer. */
export function lonLatText(
  [lon, lat]: LonLat,
  format: CoordinateFormat,
  decimals = 6,
): readonly [lat: string, lon: string] {
  const west = (360 - lon) % 360;
  switch (format) {
    case "dms": {
      const [fine, ns] = [Math.max(0, decimals - 3), lat < 0 ? "S" : "N"];
      return [`${sexagesimal(lat, fine)} ${ns}`, `${sexagesimal(lon, fine)} E`];
    }
    case "west":
      return [`${fixed(lat, decimals)}°`, `${fixed(west, decimals)}° W`];
    default:
      return [`${fixed(lat, decimals)}°`, `${fixed(lon, decimals)}° E`];
  }
}

/** A place in the frames of the nearest stop: site frame and rover frame. */
export function inFrames(
  [east, north]: MapPoint,
  elevation_m: number | null,
  frames: Pick<SceneStops, "stops" | "sites">,
  decimals: number,
): readonly (readonly [frame: string, text: string])[] {
  const distance2 = ({ place }: { readonly place: Place3 }) =>
    Math.hypot(place[0] - east, place[1] - north);
  const [stop] = frames.stops.toSorted((a, b) => distance2(a) - distance2(b));
  if (!stop) return [];
  const titles = [siteTitle(stop.site), roverTitle(stop.site, stop.drive)];
  return framesOf(frames)
    .filter(({ title }) => titles.includes(title))
    .map(({ title, place, rows }) => {
      const off = [
        east - place[0],
        north - place[1],
        (elevation_m ?? place[2]) - place[2],
      ] as const;
      const along = (k: 0 | 1 | 2) =>
        fixed(rows[0][k] * off[0] + rows[1][k] * off[1] + rows[2][k] * off[2], decimals);
      const axes = elevation_m === null ? ([0, 1] as const) : ([0, 1, 2] as const);
      return [title, `${axes.map(along).join(", ")} m`] as const;
    });
}
