/**
 * How the surface of a stop joins those of its neighbours in a merged map: its elevation is that of the merged terrain
 * model, in which there is no step between stops, with the stop's own detail.
 */

import { type MosaicPlan, mosaicPlan } from "../../../map/mosaic";
import { valueTile } from "../../../map/painted-tiles";
import type { MapPoint, RasterLayer, TileMatrixSet } from "../../../server/records";
import type { Context } from "../../../session/context";
import { layerFor, overlap } from "./drape";
import type { Partition } from "./partition";

/** Cells along the longer side at which elevations are compared. */
const MOST_PX = 384;

export class Join {
  private constructor(
    private readonly plan: MosaicPlan,
    /** Correction to add to the stop's elevation, metres. */
    private readonly rises: Float32Array,
  ) {}

  /** The corrections of a stop in a partition; null if the stop has no terrain model in it. */
  static async of(context: Context, partition: Partition, scope: string): Promise<Join | null> {
    const set = context.mission.tile_matrix_set;
    const [own, merged] = [true, false].map((isAlone) =>
      layerFor(context, "dtm", scope, isAlone, partition.bounds),
    );
    const bounds = own && overlap(own.bounds, partition.bounds);
    if (!own || !merged || own === merged || !bounds) return null;
    const plan = mosaicPlan(merged, set, bounds, MOST_PX);
    const [from, to] = await Promise.all([valuesOf(own, set, plan), valuesOf(merged, set, plan)]);
    return new Join(
      plan,
      from.map((metres, k) => (to[k] ?? 0) - metres || 0),
    );
  }

  /** Correction of the stop's elevation at a place, metres. */
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
