/** Layers of dropped files on the map, over those of the server and below annotations. */

import GeoJSON from "ol/format/GeoJSON";
import type { FeatureLike } from "ol/Feature";
import type Feature from "ol/Feature";
import type Geometry from "ol/geom/Geometry";
import type BaseLayer from "ol/layer/Base";
import ImageLayer from "ol/layer/Image";
import OlVectorLayer from "ol/layer/Vector";
import { addCoordinateTransforms } from "ol/proj";
import Projection from "ol/proj/Projection";
import ImageStatic from "ol/source/ImageStatic";
import VectorSource from "ol/source/Vector";
import CircleStyle from "ol/style/Circle";
import Fill from "ol/style/Fill";
import Stroke from "ol/style/Stroke";
import Style from "ol/style/Style";
import Text from "ol/style/Text";
import type { GeoJsonFeature } from "../../map/mars-geojson";
import { textOf } from "./annotations";
import type { FileFeatures, FileImage } from "./read";

const Z_IMAGE = 902;
const Z_FEATURES = 950;

export interface Drawn {
  readonly map: BaseLayer;
  /** Sets the colour; null: it has its own colours. */
  readonly setColour: ((colour: string) => void) | null;
}

export function drawnFeatures({ features }: FileFeatures, colour: string): Drawn {
  const collection = { type: "FeatureCollection", features };
  const read = new GeoJSON().readFeatures(collection) as Feature<Geometry>[];
  const source = new VectorSource({ features: read });
  const map = new OlVectorLayer({ source, zIndex: Z_FEATURES, declutter: true });
  const setColour = (other: string) => map.setStyle((feature) => styleOf(feature, other));
  setColour(colour);
  return { map, setColour };
}

function styleOf(feature: FeatureLike, colour: string): Style {
  const { geometry: _, ...properties } = feature.getProperties();
  const text = textOf({ properties } as unknown as GeoJsonFeature, "");
  const stroke = new Stroke({ color: colour, width: 2 });
  return new Style({
    stroke,
    fill: new Fill({ color: `${colour}33` }),
    image: new CircleStyle({
      radius: 5,
      fill: new Fill({ color: colour }),
      stroke: new Stroke({ color: "#fff", width: 1.5 }),
    }),
    text: new Text({
      text,
      font: "12px system-ui, sans-serif",
      offsetY: -13,
      fill: new Fill({ color: "#111" }),
      stroke: new Stroke({ color: "#fff", width: 3 }),
    }),
  });
}

let count = 0;

export function drawnImage({ url, extent, crs }: FileImage, local: Projection): Drawn {
  let projection = local;
  if (!crs.isLocal) {
    projection = new Projection({
      code: `solmap:file-${count++}`,
      units: "m",
      extent: [...extent],
    });
    const middle = (extent[0] + extent[2]) / 2;
    const there = (place: number[]) => [...crs.toMap(place)];
    const back = (place: number[]) => {
      const [x = 0, y = 0] = crs.fromMap(place);
      return [crs.isDegrees ? x - 360 * Math.round((x - middle) / 360) : x, y];
    };
    addCoordinateTransforms(projection, local, there, back);
  }
  const source = new ImageStatic({ url, imageExtent: [...extent], projection });
  return { map: new ImageLayer({ source, zIndex: Z_IMAGE }), setColour: null };
}
