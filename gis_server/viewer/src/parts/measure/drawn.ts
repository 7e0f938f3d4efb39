/** Measurements that were made, drawn on the map with their numbers. */

import Feature from "ol/Feature";
import type Geometry from "ol/geom/Geometry";
import LineString from "ol/geom/LineString";
import MultiPoint from "ol/geom/MultiPoint";
import Point from "ol/geom/Point";
import Polygon from "ol/geom/Polygon";
import ImageLayer from "ol/layer/Image";
import OlVectorLayer from "ol/layer/Vector";
import type OlMap from "ol/Map";
import ImageStatic from "ol/source/ImageStatic";
import type Projection from "ol/proj/Projection";
import VectorSource from "ol/source/Vector";
import CircleStyle from "ol/style/Circle";
import Fill from "ol/style/Fill";
import Stroke from "ol/style/Stroke";
import Style from "ol/style/Style";
import Text from "ol/style/Text";
import { zIndex } from "../../map/layers";
import type { Bounds, MapPoint } from "../../server/records";
import type { Measurement } from "./export";
import type { Overlay } from "./mode";
import { quantityText } from "./quantities";

const Z_INDEX = 995;
/** Over the rasters, below the symbols, as layers are stacked at first. */
const OVERLAY_Z_INDEX = zIndex({ kind: "footprints", level: "region" }) - 1;
const INK = "#101113";
const LINE = "#ffffff";
const IN_THE_WAY = "#d4141c";
const WAY = "#35d07f";

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

/** A ring around the obstruction. */
function inTheWay(mark: MapPoint): Style {
  const ring = new CircleStyle({
    radius: 7,
    fill: new Fill({ color: IN_THE_WAY }),
    stroke: new Stroke({ color: LINE, width: 2 }),
  });
  return new Style({ geometry: new Point([...mark]), image: ring, zIndex: 1 });
}

/** The found route; the drawn line only gives its ends. */
function wayFound(way: readonly MapPoint[]): Style[] {
  const geometry = new LineString(way.map((place) => [...place]));
  return [
    new Style({ geometry, stroke: new Stroke({ color: INK, width: 5 }), zIndex: 1 }),
    new Style({ geometry, stroke: new Stroke({ color: WAY, width: 2.5 }), zIndex: 1 }),
  ];
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
  const { mark, way } = measurement.found;
  return [
    ...(mark ? [inTheWay(mark)] : []),
    ...(way ? wayFound(way) : []),
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

function overlayLayer({ url, bounds }: Overlay, projection: Projection): ImageLayer<ImageStatic> {
  const source = new ImageStatic({
    url,
    imageExtent: [...bounds],
    projection,
    interpolate: false, // classes have no values between them
  });
  return new ImageLayer({ source, zIndex: OVERLAY_Z_INDEX });
}

export class DrawnMeasurements {
  private readonly source = new VectorSource<Feature<Geometry>>();
  private readonly overlays = new Map<Overlay, ImageLayer<ImageStatic>>();
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
    this.showOverlays(all.flatMap(({ found }) => found.overlay ?? []));
  }

  /** Overlays images on the layers, and removes those whose measurement was deleted. */
  private showOverlays(shown: readonly Overlay[]): void {
    for (const [overlay, layer] of this.overlays) {
      if (shown.includes(overlay)) continue;
      this.map.removeLayer(layer);
      this.overlays.delete(overlay);
    }
    for (const overlay of shown) {
      if (this.overlays.has(overlay)) continue;
      const layer = overlayLayer(overlay, this.map.getView().getProjection());
      this.overlays.set(overlay, layer);
      this.map.addLayer(layer);
    }
  }

  dispose(): void {
    this.showOverlays([]);
    this.map.removeLayer(this.layer);
  }
}
