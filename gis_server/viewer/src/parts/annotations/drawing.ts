/** Styles of annotations on the map. */

import type { FeatureLike } from "ol/Feature";
import CircleStyle from "ol/style/Circle";
import Fill from "ol/style/Fill";
import Stroke from "ol/style/Stroke";
import Style from "ol/style/Style";
import Text from "ol/style/Text";
import { categoryOf } from "./categories";

const LONGEST = 40;

export function drawAnnotation(feature: FeatureLike): Style {
  const colour = String(feature.get("colour") ?? categoryOf(feature.get("category")).colour);
  const lineDash = feature.get("state") === "draft" ? [6, 5] : undefined;
  const text = String(feature.get("text") ?? "");
  return new Style({
    stroke: new Stroke({ color: colour, width: 2, ...(lineDash ? { lineDash } : {}) }),
    fill: new Fill({ color: `${colour}22` }),
    image: new CircleStyle({
      radius: 5,
      fill: new Fill({ color: colour }),
      stroke: new Stroke({ color: "#fff", width: 1.5 }),
    }),
    text: new Text({
      text: text.length > LONGEST ? `${text.slice(0, LONGEST)}…` : text,
      font: "12px system-ui, sans-serif",
      offsetY: -14,
      overflow: true,
      fill: new Fill({ color: "#111" }),
      stroke: new Stroke({ color: "#fff", width: 3 }),
    }),
  });
}
