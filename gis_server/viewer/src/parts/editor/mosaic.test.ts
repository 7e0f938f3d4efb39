import { expect, test } from "vitest";
import { MISSION, rasterLayer } from "../../fixtures";
import { mosaicPlan } from "./mosaic";

const SET = MISSION.tile_matrix_set;

test("tiles cover the layer at the finest zoom that fits, each where it belongs", () => {
  const layer = {
    ...rasterLayer("mer2", "orthophoto"),
    bounds: [-20.48, -20.48, 20.48, 20.48] as const,
  };
  const { cellM, width, height, tiles } = mosaicPlan(layer, SET);
  expect(cellM).toBeCloseTo(0.08, 12);
  expect([width, height]).toEqual([512, 512]);
  expect(tiles.map(({ x, y }) => [Math.round(x), Math.round(y)])).toEqual([
    [0, 0],
    [256, 0],
    [0, 256],
    [256, 256],
  ]);
  expect(tiles[0]?.url).toContain(`/17/${2 ** 16 - 1}/${2 ** 16 - 1}.webp`);
});

test("a layer too large for the picture is taken from a coarser zoom", () => {
  const layer = { ...rasterLayer("mer2", "orthophoto"), bounds: [-200, -100, 200, 100] as const };
  const { cellM, width } = mosaicPlan(layer, SET);
  expect(cellM).toBeCloseTo(0.32, 12);
  expect(width).toBeLessThanOrEqual(1600);
});
