/**
 * Drawing by hand on the map: places, a line, an area or a box. While it goes on the clicks are its own, and no part
 * hears of them. Double-click ends a line or area, Backspace takes the last corner back.
 */

import type Feature from "ol/Feature";
import type Geometry from "ol/geom/Geometry";
import LineString from "ol/geom/LineString";
import Point from "ol/geom/Point";
import Polygon from "ol/geom/Polygon";
import Draw, { createBox } from "ol/interaction/Draw";
import OlVectorLayer from "ol/layer/Vector";
import VectorSource from "ol/source/Vector";
import type { MapPoint } from "../server/records";
import type { MapView } from "./map-view";
import { drawMeasure } from "./styles";

export type Shape = "point" | "line" | "area" | "box";

export interface SketchListener {
  /** The corners while the shape grows; the last one is under the pointer. */
  readonly change?: (corners: readonly MapPoint[]) => void;
  /** The finished corners; an area is not closed, a box has four. */
  readonly end: (corners: readonly MapPoint[]) => void;
}

const TYPES = { point: "Point", line: "LineString", area: "Polygon", box: "Circle" } as const;
const Z_INDEX = 1004;
/** The map waits so long to tell a click from a double-click: the last one here is not to be heard as one. */
const CLICK_MS = 300;

const place = ([east = 0, north = 0]: readonly number[]): MapPoint => [east, north];

/** Corners of what was drawn; those of a polygon without the one that closes it. */
export function cornersOf(geometry: Geometry | undefined): MapPoint[] {
  if (geometry instanceof Point) return [place(geometry.getCoordinates())];
  if (geometry instanceof LineString) return geometry.getCoordinates().map(place);
  if (geometry instanceof Polygon)
    return (geometry.getCoordinates()[0] ?? []).slice(0, -1).map(place);
  return [];
}

/** One shape after the other, until it is stopped. */
export class Sketch {
  private readonly source = new VectorSource<Feature<Geometry>>();
  private readonly layer = new OlVectorLayer({
    source: this.source,
    style: drawMeasure,
    zIndex: Z_INDEX,
  });
  private readonly draw: Draw;
  private readonly release: () => void;

  constructor(
    private readonly view: MapView,
    shape: Shape,
    { change, end }: SketchListener,
    /** Corners at which a line or area ends by itself. */
    most?: number,
  ) {
    const box = shape === "box" ? { geometryFunction: createBox() } : {};
    this.draw = new Draw({
      source: this.source,
      type: TYPES[shape],
      style: drawMeasure,
      ...box,
      ...(most ? { maxPoints: most } : {}),
    });
    this.draw.on("drawstart", ({ feature }) => {
      this.source.clear();
      const tell = () => change?.(cornersOf(feature.getGeometry()));
      feature.getGeometry()?.on("change", tell);
    });
    this.draw.on("drawend", ({ feature }) => end(cornersOf(feature.getGeometry())));
    view.map.addLayer(this.layer);
    view.map.addInteraction(this.draw);
    this.release = view.claimClicks();
  }

  /** Takes back the last corner of the shape that grows. */
  undo(): void {
    this.draw.removeLastPoint();
  }

  /** Ends the shape that grows, as a double-click would. */
  finish(): void {
    this.draw.finishDrawing();
  }

  /** Takes away the shape that was finished. */
  clear(): void {
    this.source.clear();
  }

  stop(): void {
    this.view.map.removeInteraction(this.draw);
    this.view.map.removeLayer(this.layer);
    setTimeout(this.release, CLICK_MS);
  }
}
