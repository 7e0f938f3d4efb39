/**
 * How tie points are drawn: coloured by their residual, in classes that grow by about three, because residuals run
 * from hundredths of a pixel to blunders of many. The larger ones are drawn larger and above.
 */

import type { FeatureLike } from "ol/Feature";
import CircleStyle from "ol/style/Circle";
import Fill from "ol/style/Fill";
import Stroke from "ol/style/Stroke";
import Style from "ol/style/Style";

export interface ResidualClass {
  /** Residuals below this belong to it, pixels. */
  readonly below_px: number;
  readonly colour: string;
  readonly radius: number;
  readonly title: string;
}

export const RESIDUALS: readonly ResidualClass[] = [
  { below_px: 0.03, colour: "#2b5fc7", radius: 2.5, title: "below 0.03 px" },
  { below_px: 0.1, colour: "#3fa7d6", radius: 2.5, title: "0.03 to 0.1 px" },
  { below_px: 0.3, colour: "#7fd6a2", radius: 3, title: "0.1 to 0.3 px" },
  { below_px: 1, colour: "#f2e05b", radius: 3.5, title: "0.3 to 1 px" },
  { below_px: 3, colour: "#f58a2a", radius: 4, title: "1 to 3 px" },
  { below_px: Number.POSITIVE_INFINITY, colour: "#d4141c", radius: 5, title: "3 px and more" },
];
export const NO_RESIDUAL: ResidualClass = {
  below_px: Number.NaN,
  colour: "#8d8d8d",
  radius: 2.5,
  title: "residual not known",
};

/** The class of a residual in pixels, from the property of a feature. */
export function residualClass(residual_px: unknown): ResidualClass {
  if (typeof residual_px !== "number" || !Number.isFinite(residual_px)) return NO_RESIDUAL;
  return RESIDUALS.find(({ below_px }) => residual_px < below_px) ?? NO_RESIDUAL;
}

const STYLES = new Map(
  [NO_RESIDUAL, ...RESIDUALS].map((one, zIndex) => {
    const { colour: color, radius } = one;
    const stroke = new Stroke({ color: "rgba(0,0,0,0.55)", width: 0.8 });
    const image = new CircleStyle({ radius, fill: new Fill({ color }), stroke });
    return [one, new Style({ image, zIndex })] as const;
  }),
);

export const drawTie = (feature: FeatureLike): Style | undefined =>
  STYLES.get(residualClass(feature.get("residual_px")));
