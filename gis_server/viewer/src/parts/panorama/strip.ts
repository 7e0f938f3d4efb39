/** One panorama as an image that is moved and zoomed: OpenLayers on a plane of pixels. */

import Feature from "ol/Feature";
import Point from "ol/geom/Point";
import TileLayer from "ol/layer/Tile";
import VectorLayer from "ol/layer/Vector";
import OlMap from "ol/Map";
import Projection from "ol/proj/Projection";
import TileImage from "ol/source/TileImage";
import VectorSource from "ol/source/Vector";
import Fill from "ol/style/Fill";
import RegularShape from "ol/style/RegularShape";
import Stroke from "ol/style/Stroke";
import Style from "ol/style/Style";
import TileGrid from "ol/tilegrid/TileGrid";
import View from "ol/View";
import { h } from "../../page/dom";
import type { Panorama } from "../../server/panorama";
import type { PanoramaSight } from "../../session/state";
import { type Direction, directionAt, isInside, type PlanePoint, planePoint } from "./angles";
import { drawAxes } from "./axes";

const CLOSEST = 1 / 8;
const MARK = "#ffd400";
const PAN_SHARE = 0.1;

export interface StripListener {
  /** The pointer is over a direction; null: it left. */
  readonly hover: (direction: Direction | null) => void;
  readonly click: (direction: Direction) => void;
  /** Another part is seen; null: the whole. */
  readonly moved: (sight: PanoramaSight | null) => void;
  readonly drawn: () => void;
}

/** A cross where a place is seen; hollow where nearer ground hides it. */
const cross = (hidden: boolean) =>
  ["rgba(0, 0, 0, 0.8)", MARK].map(
    (color, k) =>
      new Style({
        image: new RegularShape({
          points: 4,
          radius: 11,
          radius2: hidden ? 11 : 0,
          angle: 0,
          fill: hidden ? new Fill({ color: "rgba(0, 0, 0, 0)" }) : new Fill({ color }),
          stroke: new Stroke({
            color,
            width: k === 0 ? 4 : 2,
            ...(hidden ? { lineDash: [3, 3] } : {}),
          }),
        }),
      }),
  );

export class Strip {
  readonly element = h("div", {
    class: "panorama-view",
    tabindex: 0,
    role: "application",
    "aria-label": "panorama: arrow keys move, plus and minus zoom",
  });
  private readonly axes = h("canvas", { class: "panorama-axes" });
  private readonly mark = new VectorSource<Feature<Point>>();
  private readonly map: OlMap;
  private readonly view: View;
  private isWhole = true;
  /** Visible part; null: the whole. */
  private seen: PanoramaSight | null = null;

  constructor(
    readonly panorama: Panorama,
    listener: StripListener,
  ) {
    const { rows, cols, max_zoom, tile_size, tiles } = panorama;
    const extent = [0, -rows, cols, 0];
    const projection = new Projection({ code: "PANORAMA", units: "pixels", extent });
    const resolutions = Array.from({ length: max_zoom + 1 }, (_, z) => 2 ** (max_zoom - z));
    const tileGrid = new TileGrid({ extent, origin: [0, 0], resolutions, tileSize: tile_size });
    const source = new TileImage({
      projection,
      tileGrid,
      wrapX: false,
      tileUrlFunction: ([z, x, y]) =>
        tiles.replace("{z}", String(z)).replace("{x}", String(x)).replace("{y}", String(y)),
    });
    this.view = new View({
      projection,
      extent,
      constrainOnlyCenter: true,
      showFullExtent: true,
      smoothExtentConstraint: false,
      minResolution: CLOSEST,
      maxResolution: (resolutions[0] ?? 1) * 2,
      center: [cols / 2, -rows / 2],
      resolution: resolutions[0] ?? 1,
    });
    this.map = new OlMap({
      target: this.element,
      controls: [],
      keyboardEventTarget: this.element,
      layers: [new TileLayer({ source }), new VectorLayer({ source: this.mark })],
      view: this.view,
    });
    this.element.append(this.axes);
    this.map.on("postrender", () => this.drawAxes());
    this.map.on("rendercomplete", () => listener.drawn());
    this.map.on("change:size", () => this.refit());
    this.map.on("moveend", () => {
      this.seen = this.sight;
      listener.moved(this.seen);
    });
    const moved = () => {
      this.isWhole = false;
    };
    this.view.on("change:resolution", moved);
    this.view.on("change:center", moved);
    this.map.on("pointermove", ({ coordinate }) => listener.hover(this.directionOf(coordinate)));
    this.map.on("singleclick", ({ coordinate }) => {
      const direction = this.directionOf(coordinate);
      if (direction) listener.click(direction);
    });
    this.element.addEventListener("pointerleave", () => listener.hover(null));
    this.element.addEventListener("keydown", (event) => this.key(event));
  }

  /** Shows the height of the panorama, or all of it where that is wider than the strip. */
  whole(): void {
    const [width = 0, height = 0] = this.map.getSize() ?? [];
    this.seen = null;
    if (width === 0 || height === 0) return;
    const { rows, cols } = this.panorama;
    this.view.setCenter([cols / 2, -rows / 2]);
    this.view.setResolution(Math.max(rows / height, cols / width));
    this.isWhole = true;
  }

  /** Shows a direction at a width; at once, or as soon as the strip has a size. */
  look(sight: PanoramaSight): void {
    const { azimuth, elevation, width } = sight;
    const [across = 0] = this.map.getSize() ?? [];
    this.seen = sight;
    if (across === 0) return;
    this.view.setCenter([...planePoint(this.panorama, [azimuth, elevation])]);
    this.view.setResolution(width / this.panorama.cell_deg / across);
  }

  private refit(): void {
    if (this.seen)
      this.look(this.seen); // keeps the width
    else if (this.isWhole) this.whole();
  }

  private get sight(): PanoramaSight | null {
    const [x = 0, y = 0] = this.view.getCenter() ?? [];
    const [across = 0] = this.map.getSize() ?? [];
    if (this.isWhole || across === 0) return null;
    const [azimuth, elevation] = directionAt(this.panorama, [x, y]);
    const width = across * (this.view.getResolution() ?? 1) * this.panorama.cell_deg;
    return { azimuth, elevation, width };
  }

  /** Marks where a place is seen; null takes the mark away. */
  put(direction: Direction | null, hidden = false): void {
    this.mark.clear();
    const point = direction && planePoint(this.panorama, direction);
    if (!point || !isInside(this.panorama, point)) return;
    const feature = new Feature(new Point([...point]));
    feature.setStyle(cross(hidden));
    this.mark.addFeature(feature);
  }

  dispose(): void {
    this.map.setTarget(undefined);
    this.map.dispose();
  }

  private directionOf([x = 0, y = 0]: readonly number[]): Direction | null {
    const point: PlanePoint = [x, y];
    return isInside(this.panorama, point) ? directionAt(this.panorama, point) : null;
  }

  private drawAxes(): void {
    const [left, , , top] = this.view.calculateExtent(this.map.getSize());
    if (left === undefined || top === undefined) return;
    drawAxes(this.axes, this.panorama, { left, top, resolution: this.view.getResolution() ?? 1 });
  }

  private key(event: KeyboardEvent): void {
    const steps: Record<string, PlanePoint> = {
      ArrowLeft: [-1, 0],
      ArrowRight: [1, 0],
      ArrowUp: [0, 1],
      ArrowDown: [0, -1],
    };
    const step = steps[event.key];
    const [width = 0] = this.map.getSize() ?? [];
    const resolution = this.view.getResolution() ?? 1;
    const [x = 0, y = 0] = this.view.getCenter() ?? [];
    if (step) {
      const by = PAN_SHARE * width * resolution;
      this.view.setCenter([x + by * step[0], y + by * step[1]]);
    } else if (event.key === "+" || event.key === "-")
      this.view.setResolution(resolution * (event.key === "+" ? 0.5 : 2));
    else if (event.key === "0") this.whole();
    else return;
    event.preventDefault();
    event.stopPropagation(); // the map has these keys too
  }
}
