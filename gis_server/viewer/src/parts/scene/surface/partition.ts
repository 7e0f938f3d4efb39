/**
 * The stop whose surface is shown at each place when the ground of all stops is shown: as in the merged map, the
 * nearest stop that saw the place.
 */

import { CanvasTexture, NearestFilter, NoColorSpace, type Texture } from "three";
import { legendQuery, SOURCE_STOP } from "../../../map/bands";
import { loadMosaic, mosaicPlan } from "../../../map/mosaic";
import { api } from "../../../server/api";
import type { Bounds, MapPoint, RasterLayer } from "../../../server/records";
import type { Context } from "../../../session/context";
import { Join } from "./join";

/** Pixels along the longer side: 8 cm for a region of 80 m. */
const MOST_PX = 1024;
/** A stop may have its terrain model and that of far ground. */
const MOST_OWN = 2;
const CHANNELS = 3;

type Rgb = readonly [red: number, green: number, blue: number];

const rgbOf = (colour: string): Rgb => {
  const value = Number.parseInt(colour.slice(1), 16);
  return [value >> 16, (value >> 8) & 255, value & 255];
};

export class Partition {
  readonly texture: Texture;
  private readonly pixels: ImageData;

  private constructor(
    private readonly context: Context,
    readonly bounds: Bounds,
    canvas: OffscreenCanvas,
    /** Colours of every stop. */
    private readonly colours: ReadonlyMap<string, readonly Rgb[]>,
  ) {
    this.texture = new CanvasTexture(canvas);
    this.texture.colorSpace = NoColorSpace;
    this.texture.minFilter = this.texture.magFilter = NearestFilter;
    this.texture.generateMipmaps = false;
    const paper = canvas.getContext("2d");
    if (!paper) throw new Error("the browser gives no canvas to read the source stops from");
    this.pixels = paper.getImageData(0, 0, canvas.width, canvas.height);
  }

  /** The partitions of all merged maps of a mission. */
  static async all(context: Context): Promise<readonly Partition[]> {
    const { layers, mission } = context;
    const sources = layers.listed.filter(({ kind }) => kind === SOURCE_STOP);
    return await Promise.all(
      sources.map(async (layer) => {
        const of = layer as RasterLayer;
        const set = mission.tile_matrix_set;
        const [{ canvas, bounds }, { classes = [] }] = await Promise.all([
          loadMosaic(of, set, mosaicPlan(of, set, of.bounds, MOST_PX)),
          api.legend(of, legendQuery(of) ?? ""),
        ]);
        const colours = new Map<string, Rgb[]>();
        for (const { name, colour } of classes)
          colours.set(name, [...(colours.get(name) ?? []), rgbOf(colour)]);
        return new Partition(context, bounds, canvas, colours);
      }),
    );
  }

  has(scope: string): boolean {
    return this.colours.has(scope);
  }

  /** Red, green and blue, 0 to 1, of the two colours that identify a stop. */
  coloursOf(scope: string): readonly number[] {
    const known = this.colours.get(scope) ?? [];
    const two = Array.from({ length: MOST_OWN }, (_, k) => known[k] ?? known[0] ?? [0, 0, 0]);
    return two.flat().map((value) => value / 255);
  }

  /** Whether a stop's surface is shown at a place. */
  shows(scope: string, [east, north]: MapPoint): boolean {
    const [west, south, right, top] = this.bounds;
    const { width, height, data } = this.pixels;
    const column = Math.floor(((east - west) / (right - west)) * width);
    const row = Math.floor(((top - north) / (top - south)) * height);
    if (column < 0 || row < 0 || column >= width || row >= height) return true;
    const at = 4 * (row * width + column);
    if (data[at + CHANNELS] === 0) return true;
    const here = data.subarray(at, at + CHANNELS);
    const own = this.colours.get(scope) ?? [];
    return own.some((colour) =>
      colour.every((value, k) => Math.abs(value - (here[k] ?? 0)) < CHANNELS),
    );
  }

  /** How a stop's surface joins those of its neighbours. */
  join(scope: string): Promise<Join | null> {
    return Join.of(this.context, this, scope);
  }

  dispose(): void {
    this.texture.dispose();
  }
}
