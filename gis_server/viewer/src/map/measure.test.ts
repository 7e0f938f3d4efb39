import { expect, test } from "vitest";
import { measure, measuredText, polygonArea } from "./measure";

test("three, four, five", () => {
  const found = measure([
    [0, 0],
    [3, 4],
  ]);
  expect(found.length_m).toBeCloseTo(5, 12);
  expect(found.azimuth_deg).toBeCloseTo(36.8699, 4); // clockwise from north
});

test("the last leg is given beside the whole", () => {
  const line = [
    [0, 0],
    [0, 10],
    [-2, 10],
  ] as const;
  expect(measuredText(measure(line))).toBe("12 m, last leg 2 m, azimuth 270.0°");
});

test("a double click adds no leg", () => {
  const line = [
    [0, 0],
    [0, 10],
    [0, 10],
  ] as const;
  expect(measure(line)).toEqual({ length_m: 10, leg_m: 10, azimuth_deg: 0 });
});

test("before the second point there is only advice", () => {
  expect(measuredText(measure([[1, 1]]))).toMatch(/click the first point/);
});

test("the area of a polygon does not depend on where it lies or which way round it is drawn", () => {
  const square: [number, number][] = [
    [1e5, 2e5],
    [1e5 + 3, 2e5],
    [1e5 + 3, 2e5 + 4],
    [1e5, 2e5 + 4],
  ];
  expect(polygonArea(square)).toBe(12);
  expect(polygonArea([...square].reverse())).toBe(12);
  expect(polygonArea(square.slice(0, 2))).toBe(0);
});
