/** Tiles of the map that are painted here, from values that the server sent. */

import ImageTile from "ol/source/ImageTile";
import type TileGrid from "ol/tilegrid/TileGrid";
import type { RasterLayer, TileMatrixSet } from "../server/records";
import { canvasOf, fade, type Pen, pen } from "./painting";
import type { TileImage } from "./mosaic";
import { recolouring } from "./imagery-style";
import { emptyTile, loadTile, recoloured } from "./image-tiles";
import type { LocalMap } from "./projection";
import { bandOf, colouringOf, hasValues, type Quantity, type RasterStyle } from "./raster-style";
import { quantityOf, type SunPlace } from "./shading";
import { SIDE, tileUrl, type ValueTile, valueTiles } from "./value-tiles";

/** Values of the 256 x 256 cells of a tile; null where nothing was measured. */
export type ValuesOf = (z: number, x: number, y: number) => Promise<Float32Array | null>;

/** Content of tiles, and a key that changes with it. */
export interface Painting {
  readonly key: string;
  readonly values: ValuesOf;
  readonly pen: Pen;
  /** Standard deviations by which opacity falls, to nothing at `most`. */
  readonly fading?: { readonly sigmas: ValuesOf; readonly most: number };
}

export class PaintedTiles extends ImageTile {
  constructor(
    private painting: Painting,
    grid: TileGrid,
    { projection }: LocalMap,
  ) {
    super({
      loader: async (z, x, y) => (await paint(this.painting, z, x, y)) ?? emptyTile(),
      projection,
      tileGrid: grid,
      transition: 0,
      wrapX: false,
    });
    this.setKey(painting.key);
  }

  /** Repaints; the tiles on the screen stay until the new ones have arrived. */
  repaint(painting: Painting): void {
    if (painting.key === this.getKey()) return;
    this.painting = painting;
    this.setKey(painting.key);
  }
}

async function paint({ values, pen: draw, fading }: Painting, z: number, x: number, y: number) {
  const [found, sigmas] = await Promise.all([values(z, x, y), fading?.sigmas(z, x, y)]);
  if (!found) return null;
  const pixels = draw(found);
  return canvasOf(fading ? fade(pixels, sigmas ?? null, fading.most) : pixels, SIDE);
}

/** Tile of a layer's values, or of another band's. */
export function valueTile(
  layer: Pick<RasterLayer, "values">,
  set: TileMatrixSet,
  [z, x, y]: readonly [number, number, number],
  band: string | null = null,
): Promise<ValueTile | null> {
  if (!layer.values) throw new Error("only layers with values can be painted here");
  const address = tileUrl(layer.values, z, x, y) + (band ? `?band=${band}` : "");
  return valueTiles.get(address, set.cell_sizes[z] ?? Number.NaN);
}

/** A layer in a style of its own. */
export function styled(
  layer: RasterLayer,
  style: RasterStyle,
  sun: SunPlace,
  set: TileMatrixSet,
): Painting {
  const { quantity, fade: most } = style;
  const colouring = colouringOf(layer, style);
  const light = quantity === "relief" ? [sun.azimuthDeg, sun.elevationDeg] : [];
  const of =
    (one: Quantity): ValuesOf =>
    async (z, x, y) => {
      const tile = await valueTile(layer, set, [z, x, y], bandOf(one));
      return tile && quantityOf(tile, one, sun);
    };
  return {
    key: JSON.stringify([layer.digest, quantity, colouring, light, most]),
    pen: pen(colouring),
    values: of(quantity),
    ...(most === null ? {} : { fading: { sigmas: of("sigma"), most } }),
  };
}

/** Tiles of a layer as the map shows them in a style; null: in the server's. */
export function tilesOf(
  layer: RasterLayer,
  style: RasterStyle | null,
  sun: SunPlace,
  set: TileMatrixSet,
): TileImage {
  if (style && hasValues(layer)) {
    const painting = styled(layer, style, sun, set);
    return (z, x, y) => paint(painting, z, x, y);
  }
  const recolour = recolouring(layer, style);
  return async (z, x, y) => {
    const drawn = await loadTile(tileUrl(layer.tiles, z, x, y));
    return drawn && recolour ? recoloured(drawn, recolour) : drawn;
  };
}
