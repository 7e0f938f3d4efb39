import { expect, test } from "vitest";
import { AS_MAPPED, placedAt, movedBy, turnedBy, under } from "./overlay-transform";

const MIDDLE = [10, -5] as const;

test("as mapped, places lie where they are", () => {
  expect(placedAt(AS_MAPPED, MIDDLE, [3, 4])).toEqual([3, 4]);
});

test("turns are clockwise about the middle, which a turn leaves where it is", () => {
  const placement = turnedBy(AS_MAPPED, 90);
  const [east, north] = placedAt(placement, MIDDLE, [10, -4]); // one metre north of the middle
  expect(east).toBeCloseTo(11, 12);
  expect(north).toBeCloseTo(-5, 12);
  expect(placedAt(movedBy(placement, 2, 3), MIDDLE, MIDDLE)).toEqual([12, -2]);
});

test("there and back again is the same place", () => {
  const placement = turnedBy(movedBy(AS_MAPPED, 0.31, -1.7), 12.5);
  const [east, north] = under(placement, MIDDLE, placedAt(placement, MIDDLE, [-2.5, 7.25]));
  expect(east).toBeCloseTo(-2.5, 12);
  expect(north).toBeCloseTo(7.25, 12);
});
