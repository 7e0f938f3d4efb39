import { expect, test } from "vitest";
import type { MapPoint } from "../server/records";
import { distances, nearestOn, placeAt } from "./along";

const line: MapPoint[] = [
  [0, 0],
  [3, 4],
  [3, 14],
];

test("distances add up along the line", () => {
  expect(distances(line)).toEqual([0, 5, 15]);
});

test.each([
  [-1, [0, 0]],
  [2.5, [1.5, 2]],
  [10, [3, 9]],
  [99, [3, 14]],
])("at %d m the line is at %j", (distance, place) => {
  expect(placeAt(line, distance)).toEqual(place);
});

test("the nearest point of the line gives its distance along the line and its distance from the place", () => {
  expect(nearestOn(line, [5, 9])).toEqual({ distance_m: 10, off_m: 2, place: [3, 9] });
  expect(nearestOn(line, [-3, -4])).toEqual({ distance_m: 0, off_m: 5, place: [0, 0] });
  expect(nearestOn([[1, 1]], [0, 0])).toBeNull();
});

test("a stop that was left and reached again by a leg of no length has a place", () => {
  const stayed: MapPoint[] = [
    [0, 0],
    [0, 0],
  ];
  expect(placeAt(stayed, 3)).toEqual([0, 0]);
  expect(nearestOn(stayed, [3, 4])?.off_m).toBe(5);
});
