import TileLayer from "ol/layer/Tile";
import OlVectorLayer from "ol/layer/Vector";
import { expect, test } from "vitest";
import { MISSION, rasterLayer, vectorLayer } from "../fixtures";
import { readFeatures, show, tileGrid } from "./map-layers";
import { localMap } from "./projection";
import type { Layer } from "../server/records";

const SET = MISSION.tile_matrix_set;
const LOCAL = localMap(MISSION);
const DRAWING = { sols: null, ellipseFactor: 1, solsAt: new Map() };

test("a raster becomes tiles and a vector becomes features", () => {
  expect(show(rasterLayer("mer2", "dtm"), SET, LOCAL, DRAWING).map).toBeInstanceOf(TileLayer);
  expect(show(vectorLayer("mer2", "stops"), SET, LOCAL, DRAWING).map).toBeInstanceOf(OlVectorLayer);
});

test("a layer of neither type is an error that shows it", () => {
  const odd = { ...rasterLayer("mer2", "dtm"), type: "mesh" } as unknown as Layer;
  expect(() => show(odd, SET, LOCAL, DRAWING)).toThrow(/unknown layer.*mesh/);
});

test("rows are counted from the north-west corner, and the lander is a corner of tiles", () => {
  const grid = tileGrid(SET, { minzoom: 12, maxzoom: 17 });
  expect(grid.getTileCoordForCoordAndZ([0.01, -0.01], 17)).toEqual([17, 2 ** 16, 2 ** 16]);
  expect(grid.getTileCoordForCoordAndZ([-0.01, 0.01], 17)).toEqual([17, 2 ** 16 - 1, 2 ** 16 - 1]);
});

test("no zoom is requested that the raster does not have", () => {
  const grid = tileGrid(SET, { minzoom: 12, maxzoom: 17 });
  expect(grid.getMinZoom()).toBe(12);
  expect(grid.getMaxZoom()).toBe(17);
  expect(grid.getResolution(17)).toBeCloseTo(0.08, 12);
});

test("features keep their metres, whatever reference system the file claims", () => {
  const point = { type: "Point", coordinates: [12.5, -3.25, 1] };
  const [feature] = readFeatures({
    type: "FeatureCollection",
    features: [{ type: "Feature", geometry: point, properties: { stop: "a" } }],
    ...{ crs: { type: "name", properties: { name: "urn:ogc:def:crs:IAU:2015:49900" } } },
  });
  expect(feature?.getGeometry()?.getExtent()).toEqual([12.5, -3.25, 12.5, -3.25]);
  expect(feature?.get("stop")).toBe("a");
});
