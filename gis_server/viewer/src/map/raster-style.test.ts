import { expect, test } from "vitest";
import { rasterLayer, vectorLayer } from "../fixtures";
import { lookup, RAMPS } from "./ramps";
import {
  bandOf,
  colouringOf,
  formatStyle,
  hasValues,
  legendFor,
  linkedStyle,
  PLAIN,
  quantitiesOf,
  type RasterStyle,
} from "./raster-style";

const dtm = {
  ...rasterLayer("mer2", "dtm"),
  unit: "m",
  range: [-2, 6] as const,
  legend: { stops: [[-2, "#000000"] as const, [6, "#ff0000"] as const], unit: "m" },
};

const read = (text: string) => linkedStyle.read(text, () => undefined);

test.each<[string, RasterStyle]>([
  ["slope::0:25", { ...PLAIN, quantity: "slope", low: 0, high: 25 }],
  ["tilt::::5", { ...PLAIN, quantity: "tilt", floor: 5 }],
  [":::::::0.2", { ...PLAIN, fade: 0.2 }],
  [":inferno:-1.25:3", { ...PLAIN, ramp: "inferno", low: -1.25, high: 3 }],
])("%s in a link gives the style that is drawn", (text, style) => {
  expect(formatStyle(style)).toBe(text);
  expect(read(text)).toEqual(style);
});

test.each(["height:inferno", "volume", "slope:rainbow", "slope::low"])(
  "%s is not a style",
  (text) => expect(read(text)).toBeUndefined(),
);

test("no text is the style of every layer at first", () => expect(read("")).toBeNull());

test("colours are the layer's own until others are chosen", () => {
  expect(colouringOf(dtm, PLAIN)).toMatchObject({ colours: ["#000000", "#ff0000"], low: -2 });
  const chosen = colouringOf(dtm, { ...PLAIN, ramp: "viridis", high: 3 });
  expect(chosen).toMatchObject({ colours: RAMPS.viridis, low: -2, high: 3 });
});

test("the legend follows the style", () => {
  expect(legendFor(dtm, null)).toBe(dtm.legend);
  const legend = legendFor(dtm, { ...PLAIN, quantity: "slope", high: 20 });
  expect(legend?.unit).toBe("degree");
  expect(legend?.stops[0]).toEqual([0, RAMPS.inferno[0]]);
  expect(legend?.stops.at(-1)).toEqual([20, RAMPS.inferno.at(-1)]);
});

test("a legend names the standard deviation by which opacity falls", () => {
  expect(legendFor(dtm, { ...PLAIN, fade: 0.2 })?.note).toMatch(/none from 0\.2.m on/);
  expect(legendFor(dtm, { ...PLAIN, quantity: "slope" })?.note).toBeUndefined();
});

test("an empty range is still drawn", () => {
  const { low, high } = colouringOf(dtm, { ...PLAIN, low: 4, high: 4 });
  expect(high).toBeGreaterThan(low);
});

test("images and features have no values", () => {
  expect(hasValues({ ...dtm, values: null })).toBe(false);
  expect(hasValues(vectorLayer("mer2", "stops"))).toBe(false);
  expect(hasValues(dtm)).toBe(true);
});

test("a ramp begins and ends with its first and last colour", () => {
  const table = lookup(RAMPS.viridis);
  expect([...table.slice(0, 4)]).toEqual([0x44, 0x01, 0x54, 255]);
  expect([...table.slice(-4)]).toEqual([0xfd, 0xe7, 0x25, 255]);
  expect([...lookup(["#000000", "#ffffff"]).slice(4 * 128, 4 * 128 + 3)]).toEqual([128, 128, 128]);
});

test("the quality of elevations and slopes is drawn from bands of their own", () => {
  const slope = { ...rasterLayer("mer2", "slope"), unit: "degree", legend: null };
  expect(quantitiesOf(dtm)).toEqual(expect.arrayContaining(["sigma", "observations", "class"]));
  expect(quantitiesOf(slope)).toEqual(["value", "sigma"]);
  expect(bandOf("sigma")).toBe("standard_deviation");
  expect(bandOf("slope")).toBeNull();
  const sigma: RasterStyle = { ...PLAIN, quantity: "sigma" };
  expect(colouringOf(dtm, sigma)).toMatchObject({ high: 0.1, unit: "m" });
  expect(colouringOf(slope, sigma)).toMatchObject({ high: 5, unit: "degree" });
});

test("ground classes have names in the legend, and unseen ground is not drawn", () => {
  const classes: RasterStyle = { ...PLAIN, quantity: "class" };
  const names = legendFor({ ...dtm, values: "v" }, classes)?.classes?.map(({ name }) => name);
  expect(names).toEqual(["measured", "interpolated", "occluded"]);
  expect(colouringOf(dtm, classes).floor).toBe(1);
});
