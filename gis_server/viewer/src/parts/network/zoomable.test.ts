import { expect, test } from "vitest";
import { zoomedBox } from "./zoomable";

const WHOLE = { x: 0, y: 0, side: 1000 };

test("what is under the pointer stays there", () => {
  const box = zoomedBox(WHOLE, 0.5, [200, 600], 1000);
  expect(box).toEqual({ x: 100, y: 300, side: 500 });
  const share = ({ x, side }: typeof WHOLE) => (200 - x) / side;
  expect(share(box)).toBe(share(WHOLE));
});

test("zoom has an end on both sides", () => {
  expect(zoomedBox(WHOLE, 1e-9, [0, 0], 1000).side).toBe(62.5);
  expect(zoomedBox(WHOLE, 1e9, [0, 0], 1000).side).toBe(1500);
});
