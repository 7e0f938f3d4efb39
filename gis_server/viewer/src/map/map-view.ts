/** The map itself: layers in the local frame, pointer, highlight and mark. */

import { defaults as defaultControls } from "ol/control/defaults";
import type Feature from "ol/Feature";
import type Geometry from "ol/geom/Geometry";
import { defaults as defaultInteractions } from "ol/interaction/defaults";
import BaseVectorLayer from "ol/layer/BaseVector";
import OlVectorLayer from "ol/layer/Vector";
import type OlMap from "ol/Map";
import type MapBrowserEvent from "ol/MapBrowserEvent";
import TileSource from "ol/source/Tile";
import VectorSource from "ol/source/Vector";
import View from "ol/View";
import { ThrottledMap, TILES_ON_THEIR_WAY } from "./throttled-map";
import { isNeeded } from "./extent-of-need";
import { type FeatureSource, type Shown, show } from "./map-layers";
import type { Place } from "../session/state";
import type { LocalMap } from "./projection";
import type { Bounds, Layer, MapPoint, Mission } from "../server/records";
import {
  type Draw,
  type DrawingState,
  drawHighlight,
  drawingOf,
  drawMark,
  drawMeasure,
  pointFeature,
} from "./styles";
import { nearest } from "./touch";

const TOUCH_PX = 5;
/** Kinds of which a click opens something. */
export const CLICKABLE: ReadonlySet<string> = new Set(["stops", "footprints", "pointing"]);
const TOUCHABLE: ReadonlySet<string> = new Set([...CLICKABLE, "tie-points"]);
const PADDING_PX = [56, 40, 72, 40];

function overlay(style: Draw, zIndex: number) {
  const source = new VectorSource<Feature<Geometry>>();
  return { source, layer: new OlVectorLayer({ source, style, zIndex }) };
}

export interface Touched {
  readonly feature: Feature<Geometry>;
  readonly layer: Layer;
}

export class MapView {
  readonly map: OlMap;
  private readonly onMap = new Map<string, Shown>();
  private known: ReadonlyMap<string, Layer> = new Map();
  private readonly highlight = overlay(drawHighlight, 1000);
  private readonly mark = overlay(drawMark, 1001);
  private readonly cursor = overlay(drawMark, 1003);
  private readonly picked = overlay(drawMeasure, 1002);
  private highlighted: readonly Feature<Geometry>[] = [];
  private claims = 0;

  constructor(
    target: HTMLElement,
    readonly mission: Mission,
    layers: readonly Layer[],
    readonly local: LocalMap,
    readonly drawing: DrawingState,
  ) {
    const set = mission.tile_matrix_set;
    const finest = set.cell_sizes.at(-1) ?? 0.01;
    this.map = new ThrottledMap({
      target,
      maxTilesLoading: TILES_ON_THEIR_WAY,
      controls: defaultControls({ zoom: false, rotate: false, attribution: false }),
      // The map fills the page: the wheel needs no click first.
      interactions: defaultInteractions(),
      layers: [this.highlight, this.mark, this.picked, this.cursor].map(({ layer }) => layer),
      view: new View({
        projection: local.projection,
        constrainOnlyCenter: true,
        extent: [...set.extent],
        minResolution: finest / 8,
        maxResolution: (set.cell_sizes[0] ?? 100) * 4,
      }),
    });
    this.setLayers(layers);
  }

  /** Layers that were shown at least once. */
  get shown(): ReadonlyMap<string, Shown> {
    return this.onMap;
  }

  /** A layer of the map, created when it is first requested: of fifteen thousand layers a map shows few. */
  made(id: string): Shown | null {
    const made = this.onMap.get(id);
    const layer = this.known.get(id);
    if (made || !layer) return made ?? null;
    const shown = show(layer, this.mission.tile_matrix_set, this.local, this.drawing);
    shown.map.setVisible(false);
    this.onMap.set(id, shown);
    this.map.addLayer(shown.map);
    return shown;
  }

  /** Sets the known layers; one whose product is unchanged stays as it is. */
  setLayers(layers: readonly Layer[]): void {
    this.known = new Map(layers.map((layer) => [layer.id, layer] as const));
    for (const [id, shown] of this.onMap) {
      if (this.known.get(id)?.digest === shown.layer.digest) continue;
      this.map.removeLayer(shown.map);
      this.onMap.delete(id);
    }
  }

  /** Features of some layers, fetched if they are not there yet. */
  async featuresOf(layers: readonly Layer[]): Promise<Feature<Geometry>[]> {
    const sources = await Promise.all(layers.map(({ id }) => this.made(id)?.load()));
    return sources.flatMap((source) => source?.getFeatures() ?? []);
  }

  /** Values of a property of the features of a layer that were fetched. */
  valuesOf({ id }: Layer, property: string): readonly unknown[] {
    const { map } = this.onMap.get(id) ?? {};
    const source = map instanceof BaseVectorLayer ? map.getSource() : null;
    return source?.getFeatures().map((feature: Feature) => feature.get(property)) ?? [];
  }

  get view(): View {
    return this.map.getView();
  }

  get resolution(): number {
    return this.view.getResolution() ?? 1;
  }

  get place(): Place {
    const [east = 0, north = 0] = this.view.getCenter() ?? [];
    const rotationDeg = (this.view.getRotation() * 180) / Math.PI;
    return { east, north, resolution: this.resolution, rotationDeg };
  }

  goTo({ east, north, resolution, rotationDeg }: Place): void {
    this.view.cancelAnimations();
    this.view.setCenter([east, north]);
    this.view.setResolution(resolution);
    this.view.setRotation((rotationDeg * Math.PI) / 180);
  }

  fit(bounds: Bounds, duration = 250): void {
    const [west, south, east, north] = bounds;
    const least = 0.5;
    const [dx, dy] = [
      Math.max(0, least - (east - west)) / 2,
      Math.max(0, least - (north - south)) / 2,
    ];
    this.view.fit([west - dx, south - dy, east + dx, north + dy], {
      padding: PADDING_PX,
      duration,
    });
  }

  zoomBy(factor: number): void {
    this.view.animate({ resolution: this.resolution * factor, duration: 150 });
  }

  northUp(): void {
    this.view.animate({ rotation: 0, duration: 200 });
  }

  redraw(): void {
    for (const item of this.shown.values()) if (item.layer.type === "vector") item.map.changed();
  }

  /** The uppermost stop, tie point, pointing line or footprint near a pixel. */
  touched(pixel: number[], kinds = TOUCHABLE): Touched | null {
    const at = this.map.getCoordinateFromPixel(pixel);
    const within = TOUCH_PX * this.resolution;
    const shown = [...this.shown.values()].filter((item) => this.isTouchable(item, kinds));
    shown.sort((a, b) => (b.map.getZIndex() ?? 0) - (a.map.getZIndex() ?? 0));
    for (const { layer, map } of shown) {
      const source = (map as OlVectorLayer).getSource() as FeatureSource | null;
      const draw = drawingOf(layer.kind, this.drawing);
      const isDrawn = (feature: Feature<Geometry>) => Boolean(draw(feature, this.resolution));
      const feature = source && at ? nearest(source, at, within, isDrawn) : null;
      if (feature) return { feature, layer };
    }
    return null;
  }

  private isTouchable({ layer, map }: Shown, kinds: ReadonlySet<string>): boolean {
    if (!kinds.has(layer.kind) || !map.getVisible()) return false;
    return this.resolution <= map.getMaxResolution();
  }

  /** Whether the current view shows anything of a layer. */
  shows(layer: Layer): boolean {
    const [west = 0, south = 0, east = 0, north = 0] = this.view.calculateExtent(
      this.map.getSize(),
    );
    return isNeeded(layer, [west, south, east, north], this.resolution);
  }

  setHighlight(features: readonly Feature<Geometry>[]): void {
    const isSame = (feature: Feature<Geometry>, k: number) => feature === features[k];
    if (features.length === this.highlighted.length && this.highlighted.every(isSame)) return;
    this.highlighted = features;
    this.highlight.source.clear();
    this.highlight.source.addFeatures(features.map((feature) => feature.clone()));
  }

  /** Repeats requests that failed while the server did not answer. */
  reloadTiles(): void {
    for (const layer of this.map.getAllLayers()) {
      const source = layer.getSource();
      if (source instanceof TileSource) source.refresh();
      else source?.changed();
    }
  }

  setMark(point: MapPoint | null): void {
    put(this.mark.source, point);
  }

  /** Picked places that are not used yet. */
  setPicked(points: readonly MapPoint[]): void {
    this.picked.source.clear();
    this.picked.source.addFeatures(points.map(pointFeature));
  }

  /** The place that another part points at. */
  setCursor(point: MapPoint | null): void {
    put(this.cursor.source, point);
  }

  /** Whether a tool claims the pointer. */
  get isClaimed(): boolean {
    return this.claims > 0;
  }

  /** Withholds hovered features from all parts, until the returned function is called. */
  claimPointer(): () => void {
    this.claims += 1;
    let isActive = true;
    return () => {
      if (isActive) this.claims -= 1;
      isActive = false;
    };
  }

  onPointer(listener: (event: MapBrowserEvent, point: MapPoint) => void): void {
    this.map.on("pointermove", (event) => listener(event, pointOf(event)));
  }

  onClick(listener: (event: MapBrowserEvent, point: MapPoint) => void): void {
    this.map.on("singleclick", (event) => listener(event, pointOf(event)));
  }

  dispose(): void {
    this.map.setTarget(undefined);
    this.map.dispose();
  }
}

/** Replaces the features of a source by one point; a source that stays empty is not redrawn. */
function put(source: VectorSource<Feature<Geometry>>, point: MapPoint | null): void {
  if (!point && source.isEmpty()) return;
  source.clear();
  if (point) source.addFeature(pointFeature(point));
}

function pointOf(event: MapBrowserEvent): MapPoint {
  const [east = 0, north = 0] = event.coordinate;
  return [east, north];
}
