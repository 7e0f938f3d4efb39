import { expect, test } from "vitest";
import { MISSION, rasterLayer } from "../fixtures";
import { mosaicPlan } from "./mosaic";

const SET = MISSION.tile_matrix_set;

test("tiles cover the layer at the finest zoom that fits, each where it belongs", () => {
  const layer = {
    ...rasterLayer("mer2", "orthophoto"),
    bounds: [-20.48, -20.48, 20.48, 20.48] as const,
  };
  const { cellM, width, height, tiles, zoom } = mosaicPlan(layer, SET);
  expect(cellM).toBeCloseTo(0.08, 12);
  expect([width, height]).toEqual([512, 512]);
  expect(tiles.map(({ x, y }) => [x, y])).toEqual([
    [0, 0],
    [256, 0],
    [0, 256],
    [256, 256],
  ]);
  const middle = 2 ** 16;
  expect(tiles[0]).toMatchObject({ column: middle - 1, row: middle - 1 });
  expect(zoom).toBe(17);
});

test("a layer too large for the image is taken from a coarser zoom", () => {
  const layer = { ...rasterLayer("mer2", "orthophoto"), bounds: [-200, -100, 200, 100] as const };
  const { cellM, width } = mosaicPlan(layer, SET);
  expect(cellM).toBeCloseTo(0.32, 12);
  expect(width).toBeLessThanOrEqual(1600);
});

test("a part of a layer is of whole cells that hold it", () => {
  const layer = rasterLayer("mer2", "orthophoto");
  const { bounds, cellM, width, height, tiles } = mosaicPlan(layer, SET, [0.1, 0.1, 5.2, 2.6], 64);
  expect(cellM).toBeCloseTo(0.08, 12);
  const [west, south, east, north] = bounds.map((metres) => metres / 0.08);
  expect([west, south, east, north].map((cells) => Math.round(cells ?? 0))).toEqual([1, 1, 65, 33]);
  expect([width, height]).toEqual([64, 32]);
  expect(tiles.map(({ x, y }) => [x, y])).toEqual([[-1, -223]]);
});
