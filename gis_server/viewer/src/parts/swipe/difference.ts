/** The difference of two rasters on the map, with its legend, its size, and its value at the pointer. */

import {
  DifferenceLayer,
  differences,
  commonGround,
  overlaps,
  type Pair,
} from "../../map/difference";
import { hasValues } from "../../map/raster-style";
import { type Statistics, statistics } from "../../map/statistics";
import { sampleView } from "../../map/stretch";
import { tileGrid } from "../../map/map-layers";
import { SIDE } from "../../map/value-tiles";
import { compact, unitSign } from "../../page/format";
import type { Layer, MapPoint } from "../../server/records";
import type { Context } from "../../session/context";
import { differenceBox, layerName } from "./panel";
import type { Show } from "./part";

/** Shown where two rasters are the same. */
const LEAST = 1e-4;

function pairOf(a: Layer, b: Layer): Pair {
  for (const layer of [a, b])
    if (!hasValues(layer))
      throw new Error(`${layerName(layer)} is an image: only rasters of values have differences`);
  const pair = { a, b } as Pair;
  if ((a.unit ?? "") !== (b.unit ?? ""))
    throw new Error(
      `${layerName(a)} is in ${a.unit || "no unit"} and ${layerName(b)} in ${b.unit || "no unit"}: choose two of one unit`,
    );
  if (!overlaps(pair))
    throw new Error(`${layerName(a)} and ${layerName(b)} have no ground in common`);
  return pair;
}

export const showDifference: Show = (context, comparison, [a, b], box, change) => {
  const { view, layers, mission, events, waiting } = context;
  const pair = pairOf(a, b);
  const set = mission.tile_matrix_set;
  let { most } = comparison;
  let layer: DifferenceLayer | null = null;
  const draw = (found: Statistics | null) => {
    const shown = most ?? Math.max(LEAST, Number((found?.most ?? 1).toPrecision(2)));
    if (layer) layer.setMost(shown);
    else {
      layer = new DifferenceLayer(pair, set, view.local, shown);
      layer.setZIndex(Math.max(layers.height(a), layers.height(b)) + 0.1);
      view.map.addLayer(layer);
    }
    box.replaceChildren(differenceBox(pair, shown, found, setMost));
  };
  const update = async () => {
    const sample = await sampleView(view.map, set, commonGround(pair), differences(pair, set));
    if (!isOver) draw(statistics(sample));
  };
  function setMost(chosen: number | null): void {
    most = chosen;
    change({ most });
    waiting.run(update);
  }
  let isOver = false;
  const moved = () => waiting.run(update);
  view.map.on("moveend", moved);
  const stop = events.pointer.on((pointed) => {
    const here = box.querySelector(".here");
    if (here && pointed)
      void valueAt(context, pair, pointed.point).then((text) => (here.textContent = text));
  });
  waiting.run(update);
  return () => {
    isOver = true;
    stop();
    view.map.un("moveend", moved);
    if (layer) view.map.removeLayer(layer);
  };
};

async function valueAt({ view, mission }: Context, pair: Pair, point: MapPoint): Promise<string> {
  const set = mission.tile_matrix_set;
  const grid = tileGrid(set, commonGround(pair));
  const z = grid.getZForResolution(view.resolution);
  const [, x = 0, y = 0] = grid.getTileCoordForCoordAndZ([...point], z);
  const values = await differences(pair, set)(z, x, y);
  const [west = 0, , , north = 0] = grid.getTileCoordExtent([z, x, y]);
  const cell = grid.getResolution(z);
  const column = Math.min(SIDE - 1, Math.floor((point[0] - west) / cell));
  const row = Math.min(SIDE - 1, Math.floor((north - point[1]) / cell));
  const value = values?.[row * SIDE + column];
  return value === undefined || Number.isNaN(value)
    ? "not known here"
    : `here ${compact(value, 3)}${unitSign(pair.a.legend?.unit || pair.a.unit)}`;
}
