import { expect, test } from "vitest";
import { fused } from "./anaglyph";

const grey = (...values: number[]) =>
  new Uint8ClampedArray(values.flatMap((value) => [value, value, value, 255]));

test("left is red, right is cyan, moved to the right by the nudge", () => {
  const both = fused(grey(10, 20, 30), grey(1, 2, 3), 3, 1);
  expect([...both]).toEqual([10, 0, 0, 255, 20, 1, 1, 255, 30, 2, 2, 255]);
});

test("rows do not run into each other", () => {
  const both = fused(grey(10, 20, 30, 40), grey(1, 2, 3, 4), 2, 1);
  expect([both[9], both[13]]).toEqual([0, 3]);
});
