/**
 * How the surface of a stop joins those of its neighbours in a merged map: its elevation is that of the merged terrain
 * model, in which there is no step between stops, with the stop's own detail; its photograph is as bright as the merged
 * orthophoto, for which one gain and one offset a stop were computed.
 */

import { loadMosaic, type MosaicPlan, mosaicPlan } from "../../../map/mosaic";
import { valueTile } from "../../../map/painted-tiles";
import type { MapPoint, RasterLayer, TileMatrixSet } from "../../../server/records";
import type { Context } from "../../../session/context";
import { layerFor } from "./drape";
import type { Partition } from "./partition";

/** Cells along the longer side at which elevations and brightness are compared. */
const MOST_PX = 384;
/** Pixels without which a stop's brightness is not known. */
const LEAST_PX = 100;

/** Brightness of the merged map from that of a stop's own image; both 0 to 1. */
export interface Tone {
  readonly gain: number;
  readonly offset: number;
}

/** Middle and half of the distance between the quartiles. */
function spread(values: number[]): readonly [middle: number, spread: number] {
  values.sort((a, b) => a - b);
  const at = (share: number) => values[Math.floor(share * (values.length - 1))] ?? 0;
  return [at(0.5), (at(0.75) - at(0.25)) / 2];
}

/** Gain and offset that make shades, 0 to 255, those of other ones of the same ground. */
export function toneBetween(own: readonly number[], merged: readonly number[]): Tone {
  if (own.length < LEAST_PX) return { gain: 1, offset: 0 };
  const [from, to] = [spread([...own]), spread([...merged])];
  const gain = from[1] > 0 ? to[1] / from[1] : 1;
  return { gain, offset: (to[0] - gain * from[0]) / 255 };
}

export class Join {
  private constructor(
    readonly tone: Tone,
    private readonly plan: MosaicPlan,
    /** To be added to the stop's elevation, metres. */
    private readonly rises: Float32Array,
  ) {}

  /** Of a stop in a partition; null where the stop has no terrain model in it. */
  static async of(context: Context, partition: Partition, scope: string): Promise<Join | null> {
    const set = context.mission.tile_matrix_set;
    const within = partition.bounds;
    const pair = (kind: string) =>
      [true, false].map((isAlone) => layerFor(context, kind, scope, isAlone, within));
    const [own, merged] = pair("dtm");
    if (!own || !merged || own === merged) return null;
    const bounds = [0, 1, 2, 3].map((k) =>
      (k < 2 ? Math.max : Math.min)(own.bounds[k] ?? 0, within[k] ?? 0),
    );
    const [west = 0, south = 0, east = 0, north = 0] = bounds;
    if (west >= east || south >= north) return null;
    const plan = mosaicPlan(merged, set, [west, south, east, north], MOST_PX);
    const [tone, from, to] = await Promise.all([
      toneOf(
        pair("orthophoto"),
        set,
        plan,
        cellsOf(plan).map((place) => partition.shows(scope, place)),
      ),
      valuesOf(own, set, plan),
      valuesOf(merged, set, plan),
    ]);
    const rises = from.map((metres, k) => (to[k] ?? 0) - metres || 0);
    return new Join(tone, plan, rises);
  }

  /** What is added to the stop's elevation at a place, metres. */
  rise([east, north]: MapPoint): number {
    const { bounds, cellM, width, height } = this.plan;
    const [x, y] = [(east - bounds[0]) / cellM - 0.5, (bounds[3] - north) / cellM - 0.5];
    const [column, row] = [Math.floor(x), Math.floor(y)];
    if (column < 0 || row < 0 || column + 1 >= width || row + 1 >= height) return 0;
    const [u, v] = [x - column, y - row];
    const at = (rows: number, columns: number) =>
      this.rises[(row + rows) * width + column + columns] ?? 0;
    const [upper, lower] = [0, 1].map((r) => (1 - u) * at(r, 0) + u * at(r, 1));
    return (1 - v) * (upper ?? 0) + v * (lower ?? 0);
  }
}

/** Middles of the cells of a mosaic. */
function cellsOf({ bounds, cellM, width, height }: MosaicPlan): MapPoint[] {
  return Array.from({ length: width * height }, (_, k) => [
    bounds[0] + ((k % width) + 0.5) * cellM,
    bounds[3] - (Math.floor(k / width) + 0.5) * cellM,
  ]);
}

/** Values of a layer in the cells of a mosaic; NaN where it has none. */
async function valuesOf(
  layer: RasterLayer,
  set: TileMatrixSet,
  { zoom, width, height, tiles }: MosaicPlan,
): Promise<Float32Array> {
  const values = new Float32Array(width * height).fill(Number.NaN);
  await Promise.all(
    tiles.map(async ({ column, row, x, y }) => {
      const tile = await valueTile(layer, set, [zoom, column, row]);
      if (!tile) return;
      for (let r = Math.max(0, -y); r < Math.min(set.tile_size, height - y); r += 1) {
        const [first, last] = [Math.max(0, -x), Math.min(set.tile_size, width - x)];
        values.set(tile.row(r).subarray(first, last), (y + r) * width + x + first);
      }
    }),
  );
  return values;
}

/** From a stop's orthophoto to the merged one, by what both show where the stop is shown. */
async function toneOf(
  [own, merged]: readonly (RasterLayer | null)[],
  set: TileMatrixSet,
  plan: MosaicPlan,
  shown: readonly boolean[],
): Promise<Tone> {
  if (!own || !merged || own === merged) return { gain: 1, offset: 0 };
  const [from, to] = await Promise.all(
    [own, merged].map(async (layer) => {
      const { picture } = await loadMosaic(layer, set, plan);
      return picture.getContext("2d")?.getImageData(0, 0, plan.width, plan.height).data;
    }),
  );
  const shades: [own: number[], merged: number[]] = [[], []];
  shown.forEach((isShown, k) => {
    if (!isShown || !from?.[4 * k + 3] || !to?.[4 * k + 3]) return;
    shades[0].push(from[4 * k] ?? 0);
    shades[1].push(to[4 * k] ?? 0);
  });
  return toneBetween(...shades);
}
