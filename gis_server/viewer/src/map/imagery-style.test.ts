import { expect, test } from "vitest";
import { rasterLayer } from "../fixtures";
import { count, isImagery, percentiles, recolouring, shades } from "./imagery-style";
import { formatStyle, linkedStyle, PLAIN } from "./raster-style";

const photo = { ...rasterLayer("mer2", "orthophoto"), values: null };
const CLASSES = [
  { name: "good", colour: "#44bb99" },
  { name: "steep", colour: "#aa3377" },
];
const hazard = {
  ...rasterLayer("mer2", "hazard"),
  values: null,
  legend: { stops: [], unit: "", classes: CLASSES },
};

test("black and white are where they are put, and gamma lifts what is between", () => {
  const table = shades({ low: 50, high: 150, gamma: 2 });
  expect([table[0], table[50], table[75], table[150], table[255]]).toEqual([0, 0, 128, 255, 255]);
});

test("an image is stretched, or coloured by its grey values; its opacity stays", () => {
  const pixels = new Uint8ClampedArray([100, 100, 100, 255, 9, 9, 9, 0]);
  recolouring(photo, { ...PLAIN, low: 0, high: 200 })?.(pixels);
  expect([...pixels]).toEqual([128, 128, 128, 255, 11, 11, 11, 0]);
  const coloured = new Uint8ClampedArray([255, 255, 255, 255]);
  recolouring(photo, { ...PLAIN, ramp: "viridis" })?.(coloured);
  expect([...coloured]).toEqual([0xfd, 0xe7, 0x25, 255]);
});

test("a class that is hidden is not drawn, the others stay", () => {
  const pixels = new Uint8ClampedArray([0x44, 0xbb, 0x99, 255, 0xaa, 0x33, 0x77, 255]);
  recolouring(hazard, { ...PLAIN, hidden: [1] })?.(pixels);
  expect([pixels[3], pixels[7]]).toEqual([255, 0]);
  expect(isImagery(hazard)).toBe(false);
  expect(recolouring(hazard, PLAIN)).toBeNull();
});

test("two percent of the pixels lie beyond either end", () => {
  const counts = Array.from({ length: 256 }, (_, k) => (k < 100 ? 1 : 0));
  expect(percentiles(counts, 0.02)).toEqual([2, 97]);
  expect(percentiles([], 0.02)).toBeNull();
  const seen: number[] = [];
  count(new Uint8ClampedArray([7, 7, 7, 255, 7, 7, 7, 0]), seen);
  expect(seen[7]).toBe(1);
});

test.each(["value::20:180::0.8", "value::::::1.3", ":grey"])("the style %s comes back", (text) => {
  const style = linkedStyle.read(text, () => undefined);
  expect(style && linkedStyle.read(formatStyle(style), () => undefined)).toEqual(style);
});
