import { expect, test } from "vitest";
import { rasterLayer, vectorLayer } from "../../fixtures";
import { half } from "../../map/clipping";
import { colouringOfDifference, commonGround, overlaps } from "../../map/difference";
import { statistics } from "../../map/statistics";
import { firstPair } from "./comparison";

const A = rasterLayer("mer2-site0010-drive0064", "dtm");
const B = { ...rasterLayer("mer2-site0011-drive0000", "dtm"), bounds: [0, 10, 90, 90] as const };

test("two layers of a kind are compared, before any other two", () => {
  const slope = rasterLayer("mer2", "slope");
  expect(firstPair([A], [slope, A, B])?.map(({ id }) => id)).toEqual([A.id, B.id]);
  expect(firstPair([slope, A], [slope, A, B])?.map(({ id }) => id)).toEqual([A.id, B.id]);
  expect(firstPair([slope, A], [slope, A])?.map(({ id }) => id)).toEqual([slope.id, A.id]);
  expect(firstPair([vectorLayer("mer2", "stops")], [A])).toBeNull();
});

test("a difference is known where both are", () => {
  expect(commonGround({ a: A, b: { ...B, maxzoom: 15 } })).toEqual({
    bounds: [0, 10, 40, 40],
    minzoom: 12,
    maxzoom: 15,
  });
  expect(overlaps({ a: A, b: { ...B, bounds: [50, 50, 90, 90] } })).toBe(false);
});

test("no difference is white, and both directions reach as far", () => {
  const { low, high, colours } = colouringOfDifference({ a: A, b: B }, 0.2);
  expect([low, high]).toEqual([-0.2, 0.2]);
  expect(colours[(colours.length - 1) / 2]).toBe("#f7f7f7");
});

test("the two sides of the divider are the map", () => {
  expect(half("left", [100, 50], 0.3)).toEqual([
    [0, 0],
    [30, 0],
    [30, 50],
    [0, 50],
  ]);
  expect(half("right", [100, 50], 0.3)[0]).toEqual([30, 0]);
});

test("statistics are of what is known", () => {
  expect(statistics([1, 3, Number.NaN])).toEqual({ count: 2, mean: 2, sigma: 1, most: 3 });
  expect(statistics([Number.NaN])).toBeNull();
});
