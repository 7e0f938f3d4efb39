/** Cast shadows on the map: the ground of the whole view and a margin towards the sun are processed at once. */

import type { Extent } from "ol/extent";
import ImageLayer from "ol/layer/Image";
import ImageCanvas from "ol/source/ImageCanvas";
import type { RasterLayer, TileMatrixSet } from "../server/records";
import { tileGrid } from "./map-layers";
import type { LocalMap } from "./projection";
import type { SunPlace } from "./shading";
import { type Ground, shadows } from "./shadows";
import { SIDE, tileUrl, valueTiles } from "./value-tiles";

/** Cells around the view whose shadows may fall into it. */
const MARGIN = 192;
/** Most cells of the processed ground; 4 bytes each. */
const MOST = 16e6;
const COLOUR = 0x9e1e0a06; // opacity, blue, green, red: dark, a little bluish

export class ShadowLayer extends ImageLayer<ImageCanvas> {
  private sun: SunPlace;
  private readonly ground: RasterLayer & { readonly values: string };
  private readonly tiling: TileMatrixSet;

  constructor(
    ground: RasterLayer & { readonly values: string },
    tiling: TileMatrixSet,
    { projection }: LocalMap,
    sun: SunPlace,
  ) {
    super({ extent: [...ground.bounds] });
    this.ground = ground;
    this.tiling = tiling;
    this.sun = sun;
    this.setSource(
      new ImageCanvas({
        projection,
        ratio: 1,
        canvasFunction: (extent, resolution, _ratio, size) =>
          this.paint(extent, resolution, size as [number, number]),
      }),
    );
  }

  setSun(sun: SunPlace): void {
    const { azimuthDeg, elevationDeg } = this.sun;
    if (sun.azimuthDeg === azimuthDeg && sun.elevationDeg === elevationDeg) return;
    this.sun = sun;
    this.getSource()?.changed();
  }

  private paint(
    extent: Extent,
    resolution: number,
    [width, height]: readonly [number, number],
  ): HTMLCanvasElement {
    const canvas = document.createElement("canvas");
    [canvas.width, canvas.height] = [width, height];
    const window = windowOf(this.ground, this.tiling, extent, resolution);
    if (window.columns * window.rows > MOST) return canvas;
    const ground = this.read(window);
    const shadow = drawn(ground, shadows(ground, this.sun));
    const pixel = (window.cell_m / ((extent[2] ?? 0) - (extent[0] ?? 0))) * width;
    const left = ((window.west - (extent[0] ?? 0)) / window.cell_m) * pixel;
    const top = (((extent[3] ?? 0) - window.north) / window.cell_m) * pixel;
    const context = canvas.getContext("2d");
    context?.drawImage(shadow, left, top, shadow.width * pixel, shadow.height * pixel);
    return canvas;
  }

  /** The ground of a window, as far as its tiles have arrived; the map is redrawn with each that arrives. */
  private read(window: Window): Ground {
    const { columns, rows, cell_m, first, tiles, z } = window;
    const heights = new Float32Array(columns * rows).fill(Number.NaN);
    for (let y = 0; y < tiles[1]; y += 1)
      for (let x = 0; x < tiles[0]; x += 1) {
        const url = tileUrl(this.ground.values, z, first[0] + x, first[1] + y);
        const tile = valueTiles.peek(url);
        if (tile === undefined) {
          void valueTiles.get(url, cell_m).then(
            () => this.getSource()?.changed(),
            () => undefined,
          );
          continue;
        }
        for (let row = 0; tile && row < SIDE; row += 1)
          heights.set(tile.row(row), (y * SIDE + row) * columns + x * SIDE);
      }
    return { heights, columns, rows, cell_m };
  }
}

/** Whole tiles around a view, at a zoom. */
interface Window {
  readonly z: number;
  readonly cell_m: number;
  readonly west: number;
  readonly north: number;
  readonly first: readonly [x: number, y: number];
  readonly tiles: readonly [across: number, down: number];
  readonly columns: number;
  readonly rows: number;
}

function windowOf(
  layer: RasterLayer,
  set: TileMatrixSet,
  extent: Extent,
  resolution: number,
): Window {
  const grid = tileGrid(set, layer);
  const z = grid.getZForResolution(resolution);
  const cell_m = grid.getResolution(z);
  const margin = MARGIN * cell_m;
  const [west, south, east, north] = layer.bounds;
  const wide = [
    Math.max(west, (extent[0] ?? 0) - margin),
    Math.max(south, (extent[1] ?? 0) - margin),
    Math.min(east, (extent[2] ?? 0) + margin),
    Math.min(north, (extent[3] ?? 0) + margin),
  ];
  const range = grid.getTileRangeForExtentAndZ(wide, z);
  const tiles = [Math.max(0, range.getWidth()), Math.max(0, range.getHeight())] as const;
  const corner = grid.getTileCoordExtent([z, range.minX, range.minY]);
  return {
    z,
    cell_m,
    west: corner[0] ?? 0,
    north: corner[3] ?? 0,
    first: [range.minX, range.minY],
    tiles,
    columns: tiles[0] * SIDE,
    rows: tiles[1] * SIDE,
  };
}

function drawn({ columns, rows }: Ground, dark: Uint8Array): HTMLCanvasElement {
  const canvas = document.createElement("canvas");
  [canvas.width, canvas.height] = [Math.max(1, columns), Math.max(1, rows)];
  if (dark.length === 0) return canvas;
  const pixels = new Uint32Array(dark.length);
  for (let at = 0; at < dark.length; at += 1) if (dark[at]) pixels[at] = COLOUR;
  const bytes = new Uint8ClampedArray(pixels.buffer);
  canvas.getContext("2d")?.putImageData(new ImageData(bytes, columns, rows), 0, 0);
  return canvas;
}
