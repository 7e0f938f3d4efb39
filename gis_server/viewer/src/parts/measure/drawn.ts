/** Measurements that were made, drawn on the map with their numbers. */

import Feature from "ol/Feature";
import type Geometry from "ol/geom/Geometry";
import LineString from "ol/geom/LineString";
import MultiPoint from "ol/geom/MultiPoint";
import Polygon from "ol/geom/Polygon";
import OlVectorLayer from "ol/layer/Vector";
import type OlMap from "ol/Map";
import VectorSource from "ol/source/Vector";
import CircleStyle from "ol/style/Circle";
import Fill from "ol/style/Fill";
import Stroke from "ol/style/Stroke";
import Style from "ol/style/Style";
import Text from "ol/style/Text";
import type { Bounds, MapPoint } from "../../server/records";
import type { Measurement } from "./export";
import { quantityText } from "./quantities";

const Z_INDEX = 995;
const INK = "#101113";
const LINE = "#ffffff";

export function mainText({ found }: Measurement): string {
  const main = found.quantities[found.main];
  return main ? quantityText(main) : "";
}

function geometryOf({ mode, corners }: Pick<Measurement, "mode" | "corners">): Geometry {
  const places = corners.map((corner) => [...corner]);
  switch (mode.shape) {
    case "area":
      return new Polygon([[...places, places[0] ?? [0, 0]]]);
    case "point":
      return new MultiPoint(places);
    default:
      return new LineString(places);
  }
}

export function boundsOf(corners: readonly MapPoint[]): Bounds {
  const [easts, norths] = [corners.map(([east]) => east), corners.map(([, north]) => north)];
  return [Math.min(...easts), Math.min(...norths), Math.max(...easts), Math.max(...norths)];
}

function styles(measurement: Measurement): Style[] {
  const text = new Text({
    text: `${measurement.number}  ${mainText(measurement)}`,
    font: "600 12px system-ui, sans-serif",
    fill: new Fill({ color: INK }),
    stroke: new Stroke({ color: "rgba(255,255,255,0.95)", width: 4 }),
    overflow: true,
    offsetY: -12,
  });
  const dot = new CircleStyle({
    radius: 3.5,
    fill: new Fill({ color: LINE }),
    stroke: new Stroke({ color: INK, width: 1.5 }),
  });
  return [
    new Style({ stroke: new Stroke({ color: INK, width: 4.5 }) }),
    new Style({
      stroke: new Stroke({ color: LINE, width: 2 }),
      fill: new Fill({ color: "rgba(255,255,255,0.16)" }),
      image: dot,
      text,
    }),
    new Style({ geometry: new MultiPoint(measurement.corners.map((one) => [...one])), image: dot }),
  ];
}

export class DrawnMeasurements {
  private readonly source = new VectorSource<Feature<Geometry>>();
  private readonly layer = new OlVectorLayer({ source: this.source, zIndex: Z_INDEX });

  constructor(private readonly map: OlMap) {
    map.addLayer(this.layer);
  }

  show(all: readonly Measurement[]): void {
    this.source.clear();
    for (const one of all) {
      const feature = new Feature<Geometry>(geometryOf(one));
      feature.setStyle(styles(one));
      this.source.addFeature(feature);
    }
  }

  dispose(): void {
    this.map.removeLayer(this.layer);
  }
}
