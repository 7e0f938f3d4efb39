import { expect, test } from "vitest";
import { contourInterval } from "./legend";

test("the interval of contours is the least step between their elevations", () => {
  expect(contourInterval([2, -1, 0, 0, 5, 1])).toBe(1);
  expect([contourInterval([]), contourInterval([3, 3])]).toEqual([null, null]);
});
