import { expect, test } from "vitest";
import { geometryOf } from "./geometry";

const CORNERS = [
  [1.23456, 2],
  [3, 4],
  [5, 0],
] as const;

test("places, lines and areas become GeoJSON to the millimetre", () => {
  expect(geometryOf("point", CORNERS)).toEqual({ type: "Point", coordinates: [1.235, 2] });
  expect(geometryOf("line", CORNERS).coordinates).toHaveLength(3);
});

test("areas are closed", () => {
  const { type, coordinates } = geometryOf("area", CORNERS);
  expect(type).toBe("Polygon");
  const [ring] = coordinates as number[][][];
  expect(ring?.at(0)).toEqual(ring?.at(-1));
  expect(ring).toHaveLength(4);
});
