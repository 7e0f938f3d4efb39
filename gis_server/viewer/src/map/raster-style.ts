/**
 * How the viewer draws a raster's values, in place of the image that the server draws.
 *
 * In a link a style is `quantity:ramp:low:high:floor:gamma:hidden:fade`, where an empty field means the default:
 * `slope::0:25`, `tilt::::5` (only tilts of 5 degrees and more). For images low and high are grey values, 0 to 255;
 * hidden are numbers of classes, in the order of the legend, with points between.
 */

import type { Layer, Legend, RasterLayer } from "../server/records";
import { unitSign } from "../page/format";
import { as, choice, type Codec, list, number, or, record, significant } from "../codec";
import { RAMP_NAMES, RAMPS, type RampName } from "./ramps";

/** Quantities that follow from elevations. */
const DERIVED = ["relief", "slope", "aspect", "tilt"] as const;
/** Quantities that the other bands of a raster give for its values. */
export const QUALITIES = ["sigma", "pose", "observations", "class"] as const;
const OF_ELEVATIONS = ["value", ...DERIVED, ...QUALITIES] as const;
const QUANTITIES = [...OF_ELEVATIONS, "sigmas"] as const;
/** The drawn quantity: the values themselves, or one of the others. */
export type Quantity = (typeof QUANTITIES)[number];

export interface RasterStyle {
  readonly quantity: Quantity;
  /** Colours; null: the quantity's own. */
  readonly ramp: RampName | null;
  /** Value at the first and at the last colour; null: the quantity's own. */
  readonly low: number | null;
  readonly high: number | null;
  /** Values below are not drawn; null: all are. */
  readonly floor: number | null;
  /** Gamma of images: above 1 dark ground is brighter; null: unchanged. */
  readonly gamma: number | null;
  /** Hidden classes, by their numbers in the legend. */
  readonly hidden: readonly number[];
  /** Standard deviation at which opacity has fallen to zero, in proportion; null: all is opaque. */
  readonly fade: number | null;
}

export const PLAIN: RasterStyle = {
  quantity: "value",
  ramp: null,
  low: null,
  high: null,
  floor: null,
  gamma: null,
  hidden: [],
  fade: null,
};

/** Colours and range of values, as they are drawn. */
export interface Colouring {
  readonly colours: readonly string[];
  readonly low: number;
  readonly high: number;
  readonly floor: number | null;
  readonly unit: string;
}

interface Own {
  readonly title: string;
  readonly ramp: RampName;
  readonly range: readonly [number, number];
  /** Unit; null: that of the layer. */
  readonly unit: string | null;
  /** Name of the band that holds it; none: it is computed here. */
  readonly band?: string;
  /** Values below this mean "no value". */
  readonly floor?: number;
  readonly classes?: readonly (readonly [name: string, colour: string])[];
}

const OWN: Readonly<Record<Exclude<Quantity, "value">, Own>> = {
  relief: { title: "Relief under the sun", ramp: "grey", range: [0, 1], unit: "" },
  slope: { title: "Slope", ramp: "inferno", range: [0, 40], unit: "degree" },
  aspect: { title: "Aspect", ramp: "twilight", range: [0, 360], unit: "degree" },
  tilt: {
    title: "North-facing slope component",
    ramp: "redblue",
    range: [-20, 20],
    unit: "degree",
  },
  sigma: {
    title: "Standard deviation",
    ramp: "inferno",
    range: [0, 0.1],
    unit: null,
    band: "standard_deviation",
  },
  pose: {
    title: "Pose deviation",
    ramp: "inferno",
    range: [0, 0.1],
    unit: "m",
    band: "pose_deviation",
  },
  observations: {
    title: "Number of observations",
    ramp: "viridis",
    range: [0, 100],
    unit: "",
    band: "observations",
    floor: 1,
  },
  class: {
    title: "Ground class",
    ramp: "viridis",
    range: [1, 3],
    unit: "",
    band: "class",
    floor: 1,
    classes: [
      ["measured", "#21918c"],
      ["interpolated", "#fde725"],
      ["occluded", "#440154"],
    ],
  },
  sigmas: {
    title: "Difference in standard deviations",
    ramp: "inferno",
    range: [0, 3],
    unit: "σ",
    band: "disagreement_in_sigmas",
  },
};

/** Unit of slopes; elevations are in metres. */
const SIGMA_DEG = [0, 5] as const;

/** Band of a raster that contains a quantity; null: the first. */
export const bandOf = (quantity: Quantity) =>
  quantity === "value" ? null : (OWN[quantity].band ?? null);

export const quantityTitle = (quantity: Quantity) =>
  quantity === "value" ? "Values" : OWN[quantity].title;

const ELEVATIONS = new Set(["dtm", "region-dtm", "far-dtm"]);
export const isElevation = ({ kind }: Pick<Layer, "kind">) => ELEVATIONS.has(kind);
const SLOPES = new Set(["slope", "region-slope"]);

/** Quantities that may be drawn of a layer, the values themselves first. */
export function quantitiesOf(layer: Pick<Layer, "kind">): readonly Quantity[] {
  if (isElevation(layer)) return OF_ELEVATIONS;
  const own = ownStyle(layer.kind);
  if (own) return [own.quantity];
  if (layer.kind === "region-seams") return ["value", "sigmas"];
  return SLOPES.has(layer.kind) ? ["value", "sigma"] : ["value"];
}

/** Whether a layer's values have standard deviations, by which they may fade. */
export const canFade = (layer: Pick<Layer, "kind">) =>
  !ownStyle(layer.kind) && quantitiesOf(layer).includes("sigma");

/** Style of a layer that is a band of a terrain model (`bands.ts`), by its kind or id; null: of other layers. */
export function ownStyle(kind: string): RasterStyle | null {
  const quantity = QUALITIES.find((one) => kind.endsWith(`dtm-${one}`));
  return quantity ? { ...PLAIN, quantity } : null;
}

/** Standard deviation at which a layer's colours of it end. */
export const mostSigma = (layer: Pick<Layer, "kind">): number =>
  SLOPES.has(layer.kind) ? SIGMA_DEG[1] : OWN.sigma.range[1];

/** Whether the browser can draw it from its values. */
export function hasValues(layer: Layer): layer is RasterLayer & { readonly values: string } {
  return layer.type === "raster" && Boolean(layer.values);
}

export function isPlain(style: RasterStyle): boolean {
  return formatStyle(style) === "";
}

export function colouringOf(layer: RasterLayer, style: RasterStyle): Colouring {
  const { classes, ...own } = ownOf(layer, style.quantity);
  const low = style.low ?? own.range[0];
  const high = style.high ?? own.range[1];
  const legend = style.quantity === "value" ? (layer.legend?.stops ?? []) : [];
  const colours = style.ramp
    ? RAMPS[style.ramp]
    : classes
      ? classes.map(([, colour]) => colour)
      : legend.length > 1
        ? legend.map(([, colour]) => colour)
        : RAMPS[own.ramp];
  const top = high > low ? high : low + 1e-6;
  const floor = style.floor ?? own.floor ?? null;
  return { colours, low, high: top, floor, unit: own.unit ?? unitOf(layer) };
}

const unitOf = (layer: RasterLayer) => layer.legend?.unit ?? layer.unit ?? "";

function ownOf(
  layer: RasterLayer,
  quantity: Quantity,
): Pick<Own, "ramp" | "range" | "unit" | "floor" | "classes"> {
  if (quantity === "sigma" && SLOPES.has(layer.kind)) return { ...OWN.sigma, range: SIGMA_DEG };
  if (quantity !== "value") return OWN[quantity];
  const stops = layer.legend?.stops ?? [];
  const ends = [stops[0]?.[0], stops.at(-1)?.[0]];
  const [low, high] = ends[0] !== undefined && ends[1] !== undefined ? ends : [null, null];
  const range: readonly [number, number] =
    low !== null && high !== null && high !== undefined && low !== undefined
      ? [low, high]
      : (layer.range ?? [0, 1]);
  return { ramp: "grey", range, unit: unitOf(layer) };
}

/** The legend that goes with a style; the server's own where nothing was changed. */
export function legendFor(layer: RasterLayer, style: RasterStyle | null): Legend | null {
  if (!style || isPlain(style) || !hasValues(layer)) return layer.legend;
  const { classes } = ownOf(layer, style.quantity);
  const legend =
    classes && !style.ramp
      ? { stops: [], unit: "", classes: classes.map(([name, colour]) => ({ name, colour })) }
      : legendOfColours(colouringOf(layer, style));
  if (style.fade === null) return legend;
  const most = `${some.write(style.fade)}${unitSign(unitOf(layer))}`;
  return { ...legend, note: `Opacity falls with σ: full at 0, none from ${most} on.` };
}

export function legendOfColours({ colours, low, high, unit }: Colouring): Legend {
  const last = Math.max(1, colours.length - 1);
  const stops = colours.map((colour, k) => [low + ((high - low) * k) / last, colour] as const);
  return { stops, unit };
}

const some = or(null, significant(6));
const positive = or(null, significant(6, Number.MIN_VALUE));
const written: Codec<RasterStyle> = record(":", {
  quantity: or("value", choice(QUANTITIES)),
  ramp: or(null, choice(RAMP_NAMES)),
  low: some,
  high: some,
  floor: some,
  gamma: positive,
  hidden: list(".", number(0, 0)),
  fade: positive,
});

/** Text of a style in a link; empty for the default style. */
export const formatStyle = written.write;

/** The style in a link; null for the default style. */
export const linkedStyle = as(
  written,
  (style): RasterStyle | null => (isPlain(style) ? null : style),
  (style) => style ?? PLAIN,
);
