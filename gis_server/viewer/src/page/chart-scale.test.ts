import { expect, test } from "vitest";
import {
  bandPath,
  extentOf,
  linear,
  linePath,
  tickDecimals,
  tickStep,
  ticks,
  valueAt,
  widened,
} from "./chart-scale";

test("a scale and its inverse are each other's undoing", () => {
  const scale = linear([-2, 8], [100, 0]);
  expect(scale(-2)).toBe(100);
  expect(scale(8)).toBe(0);
  expect(scale.invert(scale(3.7))).toBeCloseTo(3.7, 12);
});

test.each([
  [[0, 10], 5, [0, 2, 4, 6, 8, 10]],
  [[-0.03, 0.03], 6, [-0.03, -0.02, -0.01, 0, 0.01, 0.02, 0.03]],
  [[3, 3.4], 4, [3, 3.1, 3.2, 3.3, 3.4]],
  [[102, 998], 5, [200, 400, 600, 800]],
] as const)("ticks of %j are round", (domain, count, expected) => {
  expect(ticks(domain, count)).toEqual(expected);
});

test("labels have the decimals that distinguish ticks", () => {
  expect([200, 1, 0.5, 0.02].map(tickDecimals)).toEqual([0, 0, 1, 2]);
  expect(tickStep([0, 1], 3)).toBe(0.5);
});

test("what was not measured has no extent and breaks lines and bands", () => {
  expect(extentOf([[null, Number.NaN]])).toBeNull();
  expect(extentOf([[3, null], [-1]])).toEqual([-1, 3]);
  const same = linear([0, 10], [0, 10]);
  const xs = [0, 1, 2, 3];
  expect(linePath(xs, [5, null, 6, 7], same, same)).toBe("M0.00,5.00M2.00,6.00L3.00,7.00");
  expect(bandPath(xs, [1, 1, null, 1], [2, 2, 2, 2], same, same)).toBe(
    "M0.00,2.00L1.00,2.00L1.00,1.00L0.00,1.00ZM3.00,2.00L3.00,1.00Z",
  );
});

test("a level line still gets an axis", () => {
  expect(widened([5, 5], 0.1, 0.2)).toEqual([4.88, 5.12]);
});

test("between corners a line has the value of its leg, and none in gaps or beyond its ends", () => {
  const [xs, ys] = [
    [0, 10, 20, 30, 40],
    [0, 5, null, 2, 2],
  ];
  expect([0, 4, 10, 15, 35, 41].map((x) => valueAt(xs, ys, x))).toEqual([0, 2, 5, null, 2, null]);
});
