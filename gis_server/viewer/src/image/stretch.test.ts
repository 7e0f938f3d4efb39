import { expect, test } from "vitest";
import { applied, lookUp, NO_STRETCH, percentileStretch } from "./stretch";

const grey = (...values: number[]) =>
  Uint8ClampedArray.from(values.flatMap((value) => [value, value, value, 255]));

test("without a stretch every value stays", () => {
  expect([...lookUp(NO_STRETCH)]).toEqual(Array.from({ length: 256 }, (_, k) => k));
});

test("the ends become black and white, the middle is bent by gamma", () => {
  const table = lookUp({ low: 100, high: 200, gamma: 2 });
  expect([table[50], table[100], table[200], table[250]]).toEqual([0, 0, 255, 255]);
  expect(table[125]).toBe(128); // 255 * sqrt(1/4)
});

test("an image is stretched, its opacity is not", () => {
  const table = lookUp({ low: 10, high: 20, gamma: 1 });
  expect([...applied(Uint8ClampedArray.of(10, 15, 20, 7), table)]).toEqual([0, 128, 255, 7]);
});

test("a share of the pixels is given up at both ends", () => {
  const image = grey(...Array.from({ length: 100 }, (_, k) => 50 + k), 0, 255);
  expect(percentileStretch(image, 0)).toEqual({ low: 0, high: 255, gamma: 1 });
  expect(percentileStretch(image, 0.04)).toEqual({ low: 51, high: 148, gamma: 1 });
  expect(percentileStretch(grey(7, 7, 7), 0.02)).toEqual({ low: 7, high: 8, gamma: 1 });
});
