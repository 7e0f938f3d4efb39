import { expect, test } from "vitest";
import { lengthOf, placeOn } from "./walk";

const WAY = [
  [0, 0, 0],
  [3, 4, 1],
  [3, 14, 3],
] as const;

test("a way is as long as it is on the map", () => {
  expect(lengthOf(WAY)).toBeCloseTo(15, 12);
  expect(lengthOf([])).toBe(0);
});

test("places along a way, and straight on beyond its end", () => {
  expect(placeOn(WAY, 2.5)).toEqual([1.5, 2, 0.5]);
  expect(placeOn(WAY, 10)).toEqual([3, 9, 2]);
  expect(placeOn(WAY, 20)).toEqual([3, 19, 4]);
});

test("a stop at which the rover stayed is passed", () => {
  expect(placeOn([WAY[0], WAY[0], WAY[1]], 5)).toEqual([3, 4, 1]);
});
