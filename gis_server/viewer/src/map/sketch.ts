/**
 * Drawing on the map with the pointer: places, a line, an area or a box. The map reports no clicks made while
 * drawing. Double-click or Enter ends a line or area, Backspace removes the last corner. With the
 * keyboard, arrows move the map and Space sets a corner in its middle.
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

const place = ([east = 0, north = 0]: readonly number[]): MapPoint => [east, north];

/** Corners of the drawn shape; of a polygon without the closing one. */
export function cornersOf(geometry: Geometry | undefined): MapPoint[] {
  if (geometry instanceof Point) return [place(geometry.getCoordinates())];
  if (geometry instanceof LineString) return geometry.getCoordinates().map(place);
  if (geometry instanceof Polygon)
    return (geometry.getCoordinates()[0] ?? []).slice(0, -1).map(place);
  return [];
}

/** Whether a key is pressed for the map: not to press a button or to edit a text. */
export const isForMap = ({ target }: KeyboardEvent) =>
  !(target as HTMLElement).closest("button, input, select, textarea, summary, a");

/** Corners that are needed, and at which a line or area ends by itself. */
interface Corners {
  readonly least?: number;
  readonly most?: number;
}

/** Draws one shape after the other, until it is stopped. */
export class Sketch {
  private readonly source = new VectorSource<Feature<Geometry>>();
  private readonly layer = new OlVectorLayer({
    source: this.source,
    style: drawMeasure,
    zIndex: Z_INDEX,
  });
  private readonly draw: Draw;
  private readonly release: () => void;
  private readonly lifetime = new AbortController();
  private corners: readonly MapPoint[] = [];

  constructor(
    private readonly view: MapView,
    shape: Shape,
    { change, end }: SketchListener,
    { least = shape === "area" ? 3 : 2, most }: Corners = {},
  ) {
    const box = shape === "box" ? { geometryFunction: createBox() } : {};
    this.draw = new Draw({
      source: this.source,
      type: TYPES[shape],
      style: drawMeasure,
      stopClick: true,
      ...box,
      ...(most ? { maxPoints: most } : {}),
    });
    this.draw.on("drawstart", ({ feature }) => {
      this.source.clear();
      const notify = () => {
        this.corners = cornersOf(feature.getGeometry());
        change?.(this.corners);
      };
      feature.getGeometry()?.on("change", notify);
    });
    this.draw.on("drawend", ({ feature }) => {
      this.corners = [];
      end(cornersOf(feature.getGeometry()));
    });
    this.draw.on("drawabort", () => {
      this.corners = [];
    });
    view.map.addLayer(this.layer);
    view.map.addInteraction(this.draw);
    this.release = view.claimPointer();
    const pressed = (event: KeyboardEvent) => {
      if (!isForMap(event)) return;
      if (event.key === " ") {
        event.preventDefault();
        this.setMiddle(shape, end, most);
      }
      if (shape === "point") return;
      // The last corner follows the pointer and is not set.
      if (event.key === "Enter" && this.corners.length > least) this.draw.finishDrawing();
      if (event.key === "Backspace") this.draw.removeLastPoint();
    };
    if (shape !== "box")
      document.addEventListener("keydown", pressed, { signal: this.lifetime.signal });
    view.map.getTargetElement()?.focus({ preventScroll: true });
  }

  /** Sets a corner in the middle of the map. */
  private setMiddle(shape: Shape, end: SketchListener["end"], most: number | undefined): void {
    const middle = place(this.view.view.getCenter() ?? []);
    const corners = [...this.corners.slice(0, -1), middle];
    if (shape === "point") end([middle]);
    else if (corners.length === most) {
      this.draw.abortDrawing();
      end(corners);
    } else this.begin(middle);
  }

  /** Sets a corner of a line or area. */
  begin(point: MapPoint): void {
    this.draw.appendCoordinates([[...point]]);
  }

  /** Removes the finished shape. */
  clear(): void {
    this.source.clear();
  }

  stop(): void {
    this.lifetime.abort();
    this.view.map.removeInteraction(this.draw);
    this.view.map.removeLayer(this.layer);
    this.release();
  }
}
