import Feature from "ol/Feature";
import type Geometry from "ol/geom/Geometry";
import LineString from "ol/geom/LineString";
import Point from "ol/geom/Point";
import Polygon from "ol/geom/Polygon";
import VectorSource from "ol/source/Vector";
import { expect, test } from "vitest";
import { nearest } from "./touch";

const ring = [
  [0, 0],
  [10, 0],
  [10, 10],
  [0, 10],
  [0, 0],
];
const square = new Feature<Geometry>(new Polygon([ring]));
const line = new Feature<Geometry>(
  new LineString([
    [0, 0],
    [10, 10],
  ]),
);
const place = new Feature<Geometry>(new Point([5, 5.4]));
const source = new VectorSource({ features: [square, line, place] });
const all = () => true;

test("the nearest of what is near enough", () => {
  expect(nearest(source, [5, 5.3], 0.5, all)).toBe(place);
  expect(nearest(source, [3, 3.2], 0.5, all)).toBe(line);
  expect(nearest(source, [10.3, 4], 0.5, all)).toBe(square);
  expect(nearest(source, [12, 4], 0.5, all)).toBeNull();
});

test("the inside of an outline is not touched, and neither is what is not drawn", () => {
  expect(nearest(source, [8, 3], 0.5, all)).toBeNull();
  expect(nearest(source, [5, 5.3], 0.5, (feature) => feature !== place)).toBe(line);
});
