import { expect, test } from "vitest";
import {
  centred,
  fitted,
  isInside,
  LARGEST_SCALE,
  panned,
  refitted,
  type Size,
  toImage,
  toScreen,
  zoomed,
} from "./viewport";

const IMAGE: Size = [1024, 512];
const VIEW: Size = [600, 600];

test("the centre of the first pixel lies half a pixel inside the image's corner", () => {
  const whole = fitted(IMAGE, VIEW);
  expect(toScreen(whole, [-0.5, -0.5])).toEqual([0, 150]);
  expect(toScreen(whole, [0, 0])[0]).toBeCloseTo(0.5 * (600 / 1024), 12);
});

test("screen and image are each other's undoing", () => {
  const close = centred([700.25, 33.5], 8, IMAGE, VIEW);
  const [sample, line] = toImage(close, toScreen(close, [703.125, 31.75]));
  expect(sample).toBeCloseTo(703.125, 9);
  expect(line).toBeCloseTo(31.75, 9);
});

test("what is under the pointer stays there while zooming", () => {
  let viewport = fitted(IMAGE, VIEW);
  const pointer = [410, 320] as const;
  const before = toImage(viewport, pointer);
  for (let k = 0; k < 6; k += 1) viewport = zoomed(viewport, 1.5, pointer, IMAGE, VIEW);
  const after = toImage(viewport, pointer);
  expect(after[0]).toBeCloseTo(before[0], 9);
  expect(after[1]).toBeCloseTo(before[1], 9);
});

test("zoom has an end on both sides, and the image cannot be pushed out of sight", () => {
  const deep = zoomed(fitted(IMAGE, VIEW), 1e6, [0, 0], IMAGE, VIEW);
  expect(deep.scale).toBe(LARGEST_SCALE);
  const far = zoomed(deep, 1e-9, [0, 0], IMAGE, VIEW);
  expect(far.scale).toBeCloseTo(fitted(IMAGE, VIEW).scale / 2, 12);
  const pushed = panned(fitted(IMAGE, VIEW), 1e5, -1e5, IMAGE, VIEW);
  const [sample, line] = toImage(pushed, [300, 300]);
  expect(sample).toBeCloseTo(-0.5, 9);
  expect(line).toBeCloseTo(511.5, 9);
});

test("what is in the middle stays there when the view gets another size", () => {
  const place = [300.25, 200.5] as const;
  const narrow: Size = [600, 564.5]; // a line of text more below
  const after = refitted(centred(place, 4, IMAGE, VIEW), VIEW, IMAGE, narrow);
  expect(after.scale).toBe(4);
  const [sample, line] = toImage(after, [narrow[0] / 2, narrow[1] / 2]);
  expect(sample).toBeCloseTo(place[0], 9);
  expect(line).toBeCloseTo(place[1], 9);
});

test("an image ends half a pixel beyond its last pixel's centre", () => {
  expect(isInside([1023.5, 511.5], IMAGE)).toBe(true);
  expect(isInside([1023.6, 0], IMAGE)).toBe(false);
});
