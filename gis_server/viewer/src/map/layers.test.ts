import { expect, test } from "vitest";
import { rasterLayer, vectorLayer } from "../fixtures";
import { firstBounds, firstState, groupLayers, kindTitle, zIndex } from "./layers";

const STOP_2 = "mer2-site0002-drive0000";
const STOP_10 = "mer2-site0010-drive0064";
const LAYERS = [
  rasterLayer(STOP_10, "orthophoto"),
  rasterLayer(STOP_2, "dtm"),
  vectorLayer(STOP_2, "contours"),
  vectorLayer("mer2", "stops"),
  rasterLayer("mer2", "orthophoto"),
  rasterLayer("mer2", "slope"),
  rasterLayer("mer2-sol0155", "hillshade"),
];

test("groups are the region, then sols, then stops as they were driven to", () => {
  expect(groupLayers(LAYERS).map(({ title }) => title)).toEqual([
    "Mission",
    "Sol 155",
    "Site 2 · drive 0",
    "Site 10 · drive 64",
  ]);
});

test("in a group, lines come before rasters", () => {
  const [region, , second] = groupLayers(LAYERS);
  expect(region?.layers.map(({ kind }) => kind)).toEqual(["stops", "orthophoto", "slope"]);
  expect(second?.layers.map(({ kind }) => kind)).toEqual(["contours", "dtm"]);
});

test("every layer is in one group", () => {
  const grouped = groupLayers(LAYERS).flatMap(({ layers }) => layers);
  expect(new Set(grouped)).toEqual(new Set(LAYERS));
  expect(grouped).toHaveLength(LAYERS.length);
});

test("the map is stacked relief, image, measures, lines, stops", () => {
  const stack = ["hillshade", "orthophoto", "slope", "contours", "traverse", "stops"];
  const heights = stack.map((kind) => zIndex({ kind, level: "region" }));
  expect(heights).toEqual([...heights].sort((a, b) => a - b));
  expect(zIndex({ kind: "dtm", level: "stop" })).toBeGreaterThan(
    zIndex({ kind: "dtm", level: "region" }),
  );
});

test("the widest product of a kind is shown at first, and slope is not", () => {
  const on = LAYERS.filter((layer) => firstState(layer, LAYERS).visible).map(({ id }) => id);
  expect(on.sort()).toEqual([
    "mer2-site0002-drive0000/contours",
    "mer2-sol0155/hillshade",
    "mer2/orthophoto",
    "mer2/stops",
  ]);
});

test("far ground lies under the map of its stop, and is off at first", () => {
  const far = rasterLayer(STOP_2, "far-dtm");
  expect(zIndex(far)).toBeLessThan(zIndex({ kind: "hillshade", level: "region" }));
  expect(firstState(far, [far, ...LAYERS]).visible).toBe(false);
  expect(kindTitle("far-dtm")).toBe("Far elevation (DTM)");
  const [, , stop] = groupLayers([far, ...LAYERS]);
  expect(stop?.layers.at(-1)).toBe(far);
});

test("relief shows through the orthophoto", () => {
  expect(firstState(rasterLayer("mer2", "orthophoto"), LAYERS).opacity).toBeLessThan(1);
  expect(firstState(rasterLayer("mer2", "hillshade"), LAYERS).opacity).toBe(1);
});

test("footprints and pointing lines are shown where there is no ground to look at", () => {
  const footprints = vectorLayer("mer1", "footprints");
  expect(firstState(footprints, [footprints]).visible).toBe(true);
  expect(firstState(footprints, [footprints, rasterLayer("mer1", "dtm")]).visible).toBe(false);
});

test("a kind that is new to the viewer is listed under its own name", () => {
  expect(kindTitle("rock-census")).toBe("Rock census");
  expect(groupLayers([vectorLayer("mer2", "rock-census")])).toHaveLength(1);
});

test("the first view holds what is shown, and no layer without features", () => {
  const stops = { ...vectorLayer("mer1", "stops"), bounds: [60, 70, 60, 70] } as const;
  const empty = { ...vectorLayer("mer1", "traverse"), bounds: [0, 0, 0, 0] } as const;
  const footprints = { ...vectorLayer("mer1", "footprints"), bounds: [26, 33, 106, 102] } as const;
  expect(firstBounds([stops, empty, footprints])).toEqual([26, 33, 106, 102]);
  expect(firstBounds([empty])).toBeNull();
});

test("contours bound the seen ground better than the blocks of rasters", () => {
  const contours = { ...vectorLayer("mer2", "contours"), bounds: [-26, -30, 30, 32] } as const;
  const orthophoto = { ...rasterLayer("mer2", "orthophoto"), bounds: [-40, -40, 40, 40] } as const;
  expect(firstBounds([contours, orthophoto])).toEqual([-26, -30, 30, 32]);
  expect(firstBounds([orthophoto])).toEqual([-40, -40, 40, 40]);
});

test("a merged map is shown instead of the maps of the stops that it holds", () => {
  const near = { ...rasterLayer(STOP_2, "orthophoto"), bounds: [-10, -10, 10, 10] } as const;
  const far = { ...rasterLayer(STOP_10, "orthophoto"), bounds: [900, 0, 920, 20] } as const;
  const merged = {
    ...rasterLayer("mer2-region-site0002-drive0000", "region-orthophoto"),
    level: "region",
    bounds: [-10, -10, 40, 40],
  } as const;
  const all = [near, far, merged];
  expect(all.map((layer) => firstState(layer, all).visible)).toEqual([false, true, true]);
  expect(zIndex(merged)).toBeLessThan(zIndex(near));
});
