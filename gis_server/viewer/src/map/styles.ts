/**
 * How features are drawn.
 *
 * The traverse has the paper's colours: telemetry blue, adjusted red. An error ellipse is a true figure on the map
 * (semi-axes in metres, azimuth of the major axis clockwise from north), drawn larger by a stated factor.
 */

import Feature, { type FeatureLike } from "ol/Feature";
import type Geometry from "ol/geom/Geometry";
import LineString from "ol/geom/LineString";
import MultiLineString from "ol/geom/MultiLineString";
import Point from "ol/geom/Point";
import Polygon from "ol/geom/Polygon";
import CircleStyle from "ol/style/Circle";
import Fill from "ol/style/Fill";
import RegularShape from "ol/style/RegularShape";
import Stroke from "ol/style/Stroke";
import Style from "ol/style/Style";
import Text from "ol/style/Text";
import { drawDip } from "./dip-style";
import { areIn, isIn, type Sols } from "./sols";
import { drawTie } from "./tie-style";
import { compact } from "../page/format";
import type { MapPoint } from "../server/records";

export const TELEMETRY = "#1769e0";
export const ADJUSTED = "#e02d25";
export const CONTOUR = "#8a4b14";
export const HAVEN = "#0aa3c2";
export const VIEWING = "#0b8f86";
export const UNPAIRED = "#b0359c";
export const HIGHLIGHT = "#ffd400";
/** Light edge that separates contours from dark ground. */
const CONTOUR_CASING = "rgba(255,255,255,0.4)";
const CASING = "rgba(255,255,255,0.75)";
const FONT = "11px system-ui, sans-serif";

/** State on which drawing depends besides the feature. */
export interface DrawingState {
  /** Sols whose features are drawn. */
  sols: Sols;
  /** Error ellipses are drawn this many times larger. */
  ellipseFactor: number;
  /** Sols of the stops by `placeKey`: a traverse is drawn up to the last of them. */
  solsAt: ReadonlyMap<string, readonly number[]>;
}

export type Draw = (feature: FeatureLike, resolution: number) => Style | Style[] | undefined;

const line = (color: string, width: number, lineDash?: number[]) =>
  new Stroke(lineDash ? { color, width, lineDash } : { color, width });

function label(text: string, color: string, extra: object = {}): Text {
  return new Text({
    text,
    font: FONT,
    fill: new Fill({ color }),
    stroke: line("rgba(255,255,255,0.9)", 3),
    ...extra,
  });
}

export const isAdjusted = (solution: unknown) => solution !== "telemetry";

/** Ring of an error ellipse in map metres. */
export function ellipseRing(
  [east, north]: MapPoint,
  major_m: number,
  minor_m: number,
  azimuth_deg: number,
  points = 48,
): MapPoint[] {
  const azimuth = (azimuth_deg * Math.PI) / 180;
  const [sin, cos] = [Math.sin(azimuth), Math.cos(azimuth)];
  return Array.from({ length: points + 1 }, (_, k): MapPoint => {
    const turn = (2 * Math.PI * (k % points)) / points;
    const along = major_m * Math.cos(turn);
    const across = minor_m * Math.sin(turn);
    return [east + along * sin + across * cos, north + along * cos - across * sin];
  });
}

/** How much larger than on the ground ellipses can be drawn. */
export const ELLIPSE_FACTORS = [1, 2, 5, 10, 20, 50, 100, 200, 500, 1000];
/** The largest ellipse's semi-major axis as a share of the traverse that it is drawn beside. */
const ELLIPSE_SHARE = 0.06;

/** The largest factor that keeps the largest ellipse small beside a traverse of `extent_m`. */
export function ellipseFactor(largest_m: number, extent_m: number): number {
  if (!(largest_m > 0)) return 1;
  const room = (ELLIPSE_SHARE * extent_m) / largest_m;
  return ELLIPSE_FACTORS.findLast((factor) => factor <= room) ?? 1;
}

const number = (value: unknown): number | null =>
  typeof value === "number" && Number.isFinite(value) ? value : null;

const cased = (casing: number, stroke: Stroke) => [
  new Style({ stroke: line(CASING, casing), zIndex: 1 }),
  new Style({ stroke, zIndex: 2 }),
];
const ADJUSTED_LINE = cased(5, line(ADJUSTED, 2.5));
const TELEMETRY_LINE = cased(4.5, line(TELEMETRY, 2, [7, 5]));

/** Key of a place, rounded to a centimetre. */
export const placeKey = ([east = 0, north = 0]: readonly number[]): string =>
  `${east.toFixed(2)},${north.toFixed(2)}`;

function drawTraverse(feature: FeatureLike, { sols, solsAt }: DrawingState): Style[] {
  const styles = isAdjusted(feature.get("solution")) ? ADJUSTED_LINE : TELEMETRY_LINE;
  const line = feature.getGeometry();
  if (sols === null || solsAt.size === 0 || !(line instanceof LineString)) return styles;
  const geometry = drivenOn(line, (place) => areIn(solsAt.get(placeKey(place)) ?? [], sols));
  return styles.map((style) => {
    const cut = style.clone();
    cut.setGeometry(geometry);
    return cut;
  });
}

/** The legs of a traverse that lead to stops accepted by `isSeen`. */
export function drivenOn(
  line: LineString,
  isSeen: (place: readonly number[]) => boolean,
): MultiLineString {
  const places = line.getCoordinates();
  const legs = places.slice(1).map((place, k) => [places[k] ?? place, place]);
  return new MultiLineString(legs.filter(([, end]) => end && isSeen(end)));
}

export function stopLabel(feature: FeatureLike): string {
  const [site, drive] = [feature.get("site"), feature.get("drive")];
  return site === undefined ? String(feature.get("stop") ?? "") : `${site}/${drive}`;
}

const SQUARE = new RegularShape({
  points: 4,
  radius: 5.5,
  angle: Math.PI / 4,
  fill: new Fill({ color: "#fff" }),
  stroke: line(TELEMETRY, 2),
  declutterMode: "none",
});
const TELEMETRY_STOP = [new Style({ image: SQUARE, zIndex: 3 })];
const stopDot = (fill: string, stroke: string, width: number) =>
  new CircleStyle({
    radius: 5,
    fill: new Fill({ color: fill }),
    stroke: line(stroke, width),
    declutterMode: "none", // labels avoid each other, symbols do not
  });
const [FREE_DOT, HELD_DOT] = [stopDot(ADJUSTED, "#fff", 1.5), stopDot("#fff", ADJUSTED, 2.5)];
/** Resolution from which on stops are dots, and only the first of every site is named: 12 m are 24 pixels. */
const DOTS_FROM_M = 0.5;
const NO_ELLIPSES = 0;
/** Styles of a stop and the factor they were made for: a moving map requests them in every frame. */
const stopStyles = new WeakMap<FeatureLike, { factor: number; styles: Style[] }>();

const solsOf = (feature: FeatureLike): readonly number[] => {
  const sols = feature.get("sols") as unknown;
  return Array.isArray(sols) ? (sols as readonly number[]) : [];
};

function drawStop(
  feature: FeatureLike,
  state: DrawingState,
  resolution: number,
): Style[] | undefined {
  if (!areIn(solsOf(feature), state.sols)) return undefined;
  if (!isAdjusted(feature.get("solution"))) return TELEMETRY_STOP;
  const factor = resolution > DOTS_FROM_M ? NO_ELLIPSES : state.ellipseFactor;
  const known = stopStyles.get(feature);
  if (known?.factor === factor) return known.styles;
  const styles = factor === NO_ELLIPSES ? [namedDot(feature)] : drawStopEnlarged(feature, state);
  stopStyles.set(feature, { factor, styles });
  return styles;
}

function namedDot(feature: FeatureLike): Style {
  const image = feature.get("held") ? HELD_DOT : FREE_DOT;
  const isNamed = !(Number(feature.get("drive")) > 0);
  return new Style({ image, zIndex: 4, ...(isNamed ? { text: stopName(feature) } : {}) });
}

const stopName = (feature: FeatureLike): Text =>
  label(stopLabel(feature), "#7d0f0a", {
    offsetX: 9,
    offsetY: -9,
    textAlign: "left",
    font: `600 ${FONT}`,
  });

function drawStopEnlarged(feature: FeatureLike, state: DrawingState): Style[] {
  const at = (feature.getGeometry() as Point).getCoordinates();
  const centre: MapPoint = [at[0] ?? 0, at[1] ?? 0];
  const dot = feature.get("held") ? HELD_DOT : FREE_DOT;
  const styles = [new Style({ image: dot, text: stopName(feature), zIndex: 4 })];
  const major = number(feature.get("ellipse_semi_major_m"));
  const minor = number(feature.get("ellipse_semi_minor_m"));
  if (major && minor) {
    const ring = ellipseRing(
      centre,
      major * state.ellipseFactor,
      minor * state.ellipseFactor,
      number(feature.get("ellipse_azimuth_deg")) ?? 0,
    );
    const figure = new Polygon([ring.map((point) => [...point])]);
    styles.push(
      new Style({
        geometry: figure,
        stroke: line(CASING, 3.5),
        fill: new Fill({ color: "rgba(224,45,37,0.12)" }),
        zIndex: 1,
      }),
      new Style({ geometry: figure, stroke: line(ADJUSTED, 1.5), zIndex: 2 }),
    );
  }
  return styles;
}

function drawContour(feature: FeatureLike, resolution: number): Style[] {
  const index = Boolean(feature.get("is_index"));
  const width = index ? 1.8 : 1;
  const style = new Style({ stroke: line(CONTOUR, width), zIndex: index ? 3 : 2 });
  const geometry = feature.getGeometry();
  const length = geometry instanceof LineString ? geometry.getLength() : Number.POSITIVE_INFINITY;
  if (index && length / resolution > 90) {
    const elevation = `${compact(number(feature.get("elevation_m")))} m`;
    style.setText(label(elevation, "#5d300a", { placement: "line", maxAngle: 0.6, repeat: 420 }));
  }
  return [new Style({ stroke: line(CONTOUR_CASING, width + 1.6), zIndex: 1 }), style];
}

const isUnpaired = (feature: FeatureLike) =>
  Boolean(feature.get("unpaired_because")) || feature.get("unpaired") === true;

const PAIRED = new Style({ stroke: line(VIEWING, 1) });
const ALONE = new Style({ stroke: line(UNPAIRED, 1.2, [3, 3]) });

function drawViewing(feature: FeatureLike, state: DrawingState): Style | undefined {
  if (!isIn(number(feature.get("sol")) ?? Number.NaN, state.sols)) return undefined;
  return isUnpaired(feature) ? ALONE : PAIRED;
}

const dot = (color: string) =>
  new Style({ image: new CircleStyle({ radius: 2, fill: new Fill({ color }) }) });
const [ADJUSTED_DOT, TELEMETRY_DOT] = [dot(ADJUSTED), dot(TELEMETRY)];
const HAVENS = new Style({
  stroke: line(HAVEN, 2),
  fill: new Fill({ color: "rgba(10,163,194,0.25)" }),
});
const PLAIN = new Style({
  stroke: line("#555", 1.2),
  image: new CircleStyle({ radius: 3, fill: new Fill({ color: "#555" }) }),
});

/** Drawing of a kind of features. */
export function drawingOf(kind: string, state: DrawingState): Draw {
  switch (kind) {
    case "traverse":
    case "mission-traverse":
      return (feature) => drawTraverse(feature, state);
    case "mission-stops":
      return (feature) => {
        if (!areIn(solsOf(feature), state.sols)) return undefined;
        return isAdjusted(feature.get("solution")) ? ADJUSTED_DOT : TELEMETRY_DOT;
      };
    case "stops":
      return (feature, resolution) => drawStop(feature, state, resolution);
    case "contours":
    case "region-contours":
    case "far-contours":
      return drawContour;
    case "havens":
    case "region-havens":
      return () => HAVENS;
    case "footprints":
    case "pointing":
      return (feature) => drawViewing(feature, state);
    case "tie-points":
      return (feature) => (areIn(solsOf(feature), state.sols) ? drawTie(feature) : undefined);
    case "dips":
      return drawDip;
    default:
      return () => PLAIN;
  }
}

/** The feature under the pointer, or the image that is open. */
export const drawHighlight: Draw = (feature) => {
  const geometry = feature.getGeometry();
  if (geometry instanceof Point) {
    const ring = new CircleStyle({ radius: 9, stroke: line(HIGHLIGHT, 3) });
    return [new Style({ image: ring })];
  }
  return [
    new Style({ stroke: line("rgba(0,0,0,0.55)", 5) }),
    new Style({ stroke: line(HIGHLIGHT, 3), fill: new Fill({ color: "rgba(255,212,0,0.10)" }) }),
  ];
};

const cross = (size: number, color: string, width: number) =>
  new RegularShape({ points: 4, radius: size, radius2: 0, stroke: line(color, width) });
const MARK = [
  new Style({ image: cross(11, "#000", 4) }),
  new Style({ image: cross(10, "#fff", 1.6) }),
];
export const drawMark: Draw = () => MARK;

const MEASURE = [
  new Style({ stroke: line("rgba(0,0,0,0.6)", 5) }),
  new Style({
    stroke: line("#fff", 2, [8, 5]),
    image: new CircleStyle({
      radius: 4,
      fill: new Fill({ color: "#fff" }),
      stroke: line("#000", 1),
    }),
  }),
];
export const drawMeasure: Draw = () => MEASURE;

export function pointFeature([east, north]: MapPoint): Feature<Geometry> {
  return new Feature<Geometry>(new Point([east, north]));
}
