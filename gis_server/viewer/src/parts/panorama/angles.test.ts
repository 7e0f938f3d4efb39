import { expect, test } from "vitest";
import { azimuthLabel, directionAt, isInside, marks, planePoint, rayEnd, stepFor } from "./angles";

const GRID = { west_deg: -40, top_deg: 10, cell_deg: 0.05, rows: 800, cols: 2400 };

test("the corners of the plane are those of the grid", () => {
  expect(directionAt(GRID, [0, 0])).toEqual([320, 10]);
  expect(directionAt(GRID, [2400, -800])).toEqual([80, -30]);
});

test("a direction goes to the plane and back", () => {
  for (const [azimuth, elevation] of [
    [359.5, 3.2],
    [0.25, -20],
    [79, -29.5],
  ] as const) {
    const point = planePoint(GRID, [azimuth, elevation]);
    expect(isInside(GRID, point)).toBe(true);
    const [back, above] = directionAt(GRID, point);
    expect(back).toBeCloseTo(azimuth, 9);
    expect(above).toBeCloseTo(elevation, 9);
  }
  expect(isInside(GRID, planePoint(GRID, [180, 0]))).toBe(false);
});

test("marks are round numbers, far enough apart to be read", () => {
  expect(stepFor(0.05, 60)).toBe(5);
  expect(stepFor(0.4, 60)).toBe(30);
  expect(marks(-41, -18, 10)).toEqual([-40, -30, -20]);
  expect(marks(3, 4, 10)).toEqual([]);
  expect(marks(0, 0.3, 0.1)).toHaveLength(4);
});

test("azimuths are named by the wind", () => {
  expect(azimuthLabel(360, 10)).toBe("0\u00b0 N");
  expect(azimuthLabel(-45, 15)).toBe("315\u00b0 NW");
  expect(azimuthLabel(92.5, 0.5)).toBe("92.5\u00b0");
});

test("a ray to the east ends in the east", () => {
  const [east, north] = rayEnd([1, 2], 90, 10);
  expect(east).toBeCloseTo(11, 9);
  expect(north).toBeCloseTo(2, 9);
});
