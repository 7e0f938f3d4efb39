/** Layers painted over the map for the sun: relief, shadows, and ground that is steep or tilts to the north. */

import TileLayer from "ol/layer/Tile";
import { tileGrid } from "../../map/map-layers";
import { PaintedTiles, type Painting, styled } from "../../map/painted-tiles";
import { hasValues, PLAIN, type RasterStyle } from "../../map/raster-style";
import type { SunPlace } from "../../map/shading";
import { ShadowLayer } from "../../map/shadow-layer";
import type { RasterLayer } from "../../server/records";
import type { Context } from "../../session/context";
import type { Light } from "../../session/state";

const TINT = 0.75;

/** Styles by name, from the lowest on the map to the uppermost. */
export function stylesOf({ relief, tiltDeg, slopeDeg }: Light): ReadonlyMap<string, RasterStyle> {
  const styles = new Map<string, RasterStyle>();
  if (relief) styles.set("relief", { ...PLAIN, quantity: "relief" });
  if (slopeDeg !== null) styles.set("slope", { ...PLAIN, quantity: "slope", floor: slopeDeg });
  if (tiltDeg !== null) styles.set("tilt", { ...PLAIN, quantity: "tilt", floor: tiltDeg });
  return styles;
}

export class Overlays {
  private readonly painted = new Map<string, TileLayer<PaintedTiles>>();
  private shadow: ShadowLayer | null = null;
  private ground: RasterLayer | null = null;

  constructor(private readonly context: Context) {}

  show(ground: RasterLayer | null, light: Light, sun: SunPlace): void {
    if (ground?.digest !== this.ground?.digest) this.clear();
    this.ground = ground;
    if (!ground || !hasValues(ground)) return;
    const { view, mission } = this.context;
    const styles = stylesOf(light);
    for (const [name, layer] of this.painted) {
      if (styles.has(name)) continue;
      view.map.removeLayer(layer);
      this.painted.delete(name);
    }
    let height = this.base();
    for (const [name, style] of styles) {
      height += 0.01;
      const opacity = name === "relief" ? light.strength : TINT;
      this.paint(ground, name, styled(ground, style, sun, mission.tile_matrix_set), [
        height,
        opacity,
      ]);
    }
    if (!light.shadow) this.dropShadow();
    else if (this.shadow) this.shadow.setSun(sun);
    else {
      this.shadow = new ShadowLayer(ground, mission.tile_matrix_set, view.local, sun);
      view.map.addLayer(this.shadow);
    }
    this.shadow?.setZIndex(height + 0.01);
  }

  clear(): void {
    for (const layer of this.painted.values()) this.context.view.map.removeLayer(layer);
    this.painted.clear();
    this.dropShadow();
  }

  private paint(
    ground: RasterLayer,
    name: string,
    painting: Painting,
    [height, opacity]: readonly [number, number],
  ): void {
    const { view, mission } = this.context;
    const there = this.painted.get(name);
    if (there) {
      there.getSource()?.repaint(painting);
      there.setZIndex(height);
      there.setOpacity(opacity);
      return;
    }
    const source = new PaintedTiles(
      painting,
      tileGrid(mission.tile_matrix_set, ground),
      view.local,
    );
    const layer = new TileLayer({ source, extent: [...ground.bounds], opacity, zIndex: height });
    this.painted.set(name, layer);
    view.map.addLayer(layer);
  }

  private dropShadow(): void {
    if (this.shadow) this.context.view.map.removeLayer(this.shadow);
    this.shadow = null;
  }

  /** Height directly above the uppermost visible raster. */
  private base(): number {
    const { layers } = this.context;
    const rasters = layers.shown.filter(({ type }) => type === "raster");
    return Math.max(0, ...rasters.map((layer) => layers.height(layer)));
  }
}
