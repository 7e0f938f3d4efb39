import { expect, test } from "vitest";
import type { SightLine, Viewshed } from "../../server/sight";
import { measurementsCsv } from "./export";
import { chosenNumber, type NumberField } from "./mode";
import { quantityText } from "./quantities";
import { SIGHT_MODES, sightChart, sightQuantities, viewshedQuantities } from "./sight-modes";

const LAYER = { id: "mer2/dtm", kind: "dtm", digest: "0123", cell_m: 0.08 };
/** Over the top of a dome z = -d^2 / 100, from 10 m before it to 10 m behind. */
const BLOCKED: SightLine = {
  sight: "hidden",
  clearance_m: -1,
  obstruction: [0, 2, 0],
  obstruction_distance_m: 10,
  unseen_m: 0.08,
  map_distance_m: 20,
  distance_m: [0, 10, 20],
  ground_m: [-1, 0, null],
  line_m: [-1, -1, -1],
  layers: [LAYER],
};
const FREE: SightLine = {
  ...BLOCKED,
  sight: "visible",
  clearance_m: 0.5,
  obstruction: null,
  obstruction_distance_m: null,
};
const texts = (line: SightLine) =>
  sightQuantities(line).map((one) => `${one.name}: ${quantityText(one)}`);

test("a blocked line of sight names the place", () => {
  expect(texts(BLOCKED)).toEqual([
    "line of sight: blocked",
    "least height over the ground: −1.00 m",
    "blocked after: 10.00 m",
    "blocked at east: 0.00 m",
    "blocked at north: 2.00 m",
    "elevation there: 0.00 m",
    "longest unmapped stretch: 0.08 m",
    "length on the map: 20.00 m",
  ]);
});

test("a free one names no obstacle, and one without elevations is not free", () => {
  expect(texts(FREE)).toContain("line of sight: free");
  expect(texts(FREE).some((text) => text.startsWith("blocked"))).toBe(false);
  expect(texts({ ...FREE, sight: "unknown" })).toContain("line of sight: not known");
});

test("its chart has ground and line, and names the upper one", () => {
  const drawn = sightChart(BLOCKED);
  expect(drawn.summary).toContain("is blocked. It runs 1.00 m below the ground");
  expect(drawn.series.map(({ ys }) => ys)).toEqual([BLOCKED.ground_m, BLOCKED.line_m]);
  expect(sightChart(FREE).summary).toContain("is free. It runs 0.50 m above the ground");
  expect(sightChart({ ...FREE, clearance_m: null }).summary).toContain("No ground is mapped");
});

test("the word is in the table where other measurements have their number", () => {
  const [mode] = SIGHT_MODES;
  if (!mode) throw new Error("there is no line of sight");
  const found = { quantities: sightQuantities(BLOCKED), main: 0, layers: [LAYER] };
  const table = measurementsCsv([{ number: 1, mode, corners: [], found }]);
  expect(table.split("\n")[1]).toBe("1,sight,line of sight,blocked,,,mer2/dtm");
});

test("a viewshed states what is seen, hidden and not known", () => {
  const seen: Viewshed = {
    eye_elevation_m: 1.5,
    radius_m: 50,
    cell_m: 0.16,
    visible_m2: 746,
    hidden_m2: 7000,
    unknown_m2: 108,
    bounds: [-50, -50, 50, 50],
    picture: "/viewshed.png",
    geotiff: "/viewshed.tif",
    layers: [LAYER],
  };
  const texts = viewshedQuantities(seen).map(quantityText);
  expect(texts.slice(0, 3)).toEqual(["746.0 m²", "7000.0 m²", "108.0 m²"]);
});

test("an entered number stays within its range", () => {
  const field: NumberField = { key: "k", title: "t", usual: 1.5, least: 0, most: 100, step: 0.1 };
  expect(chosenNumber(field)).toBe(1.5);
  expect(chosenNumber(field, Number.NaN)).toBe(1.5);
  expect(chosenNumber(field, -2)).toBe(0);
  expect(chosenNumber(field, 250)).toBe(100);
  expect(chosenNumber(field, 0)).toBe(0);
});
