/** The difference of two rasters, cell by cell: all rasters of a landing site lie on the same cells. */

import TileLayer from "ol/layer/Tile";
import type { Bounds, RasterLayer, TileMatrixSet } from "../server/records";
import { tileGrid } from "./map-layers";
import { PaintedTiles, type Painting, valueTile, type ValuesOf } from "./painted-tiles";
import { pen } from "./painting";
import type { LocalMap } from "./projection";
import { RAMPS } from "./ramps";
import type { Colouring } from "./raster-style";
import { difference } from "./shading";

/** Two rasters: the second is subtracted from the first. */
export interface Pair {
  readonly a: RasterLayer;
  readonly b: RasterLayer;
}

/** Common bounds and zooms of both. */
export function commonGround({ a, b }: Pair): Pick<RasterLayer, "bounds" | "minzoom" | "maxzoom"> {
  const least = (one: number | null, other: number | null) =>
    one === null || other === null ? (one ?? other) : Math.min(one, other);
  const bounds: Bounds = [
    Math.max(a.bounds[0], b.bounds[0]),
    Math.max(a.bounds[1], b.bounds[1]),
    Math.min(a.bounds[2], b.bounds[2]),
    Math.min(a.bounds[3], b.bounds[3]),
  ];
  const minzoom = least(a.minzoom, b.minzoom);
  return { bounds, minzoom, maxzoom: least(a.maxzoom, b.maxzoom) };
}

export const overlaps = (pair: Pair): boolean => {
  const [west, south, east, north] = commonGround(pair).bounds;
  return west < east && south < north;
};

/** First less second; NaN where one of them is not known. */
export function differences({ a, b }: Pair, set: TileMatrixSet): ValuesOf {
  return async (z, x, y) => {
    const [first, second] = await Promise.all(
      [a, b].map((layer) => valueTile(layer, set, [z, x, y])),
    );
    return first && second ? difference(first, second) : null;
  };
}

/** Blue where the first is lower, white where both are the same, red where it is higher. */
export function colouringOfDifference({ a }: Pair, most: number): Colouring {
  const unit = a.legend?.unit || a.unit || "";
  return { colours: RAMPS.bluered, low: -most, high: most, floor: null, unit };
}

export class DifferenceLayer extends TileLayer<PaintedTiles> {
  private readonly tiles: PaintedTiles;

  constructor(
    private readonly pair: Pair,
    private readonly tiling: TileMatrixSet,
    map: LocalMap,
    most: number,
  ) {
    const ground = commonGround(pair);
    const tiles = new PaintedTiles(paintingOf(pair, tiling, most), tileGrid(tiling, ground), map);
    super({ extent: [...ground.bounds], source: tiles });
    this.tiles = tiles;
  }

  /** Spreads the colours to this difference on both sides. */
  setMost(most: number): void {
    this.tiles.repaint(paintingOf(this.pair, this.tiling, most));
  }
}

function paintingOf(pair: Pair, set: TileMatrixSet, most: number): Painting {
  return {
    key: JSON.stringify([pair.a.digest, pair.b.digest, most]),
    pen: pen(colouringOfDifference(pair, most)),
    values: differences(pair, set),
  };
}
