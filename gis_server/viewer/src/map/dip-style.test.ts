import Feature from "ol/Feature";
import LineString from "ol/geom/LineString";
import Point from "ol/geom/Point";
import { expect, test } from "vitest";
import { drawDip, towards } from "./dip-style";

const facet = (properties: object) =>
  new Feature({ geometry: new Point([100, 200]), ...properties });

test("azimuths are clockwise from north", () => {
  const [east, north] = towards(90, 2);
  expect(east).toBeCloseTo(2);
  expect(north).toBeCloseTo(0);
});

test("a plane that falls to the east has a line along north and a tick to the east", () => {
  const [along, tick, label] = drawDip(facet({ strike_deg: 0, dip_deg: 34.6 }), 0.5);
  const ends = (along?.getGeometry() as LineString).getCoordinates();
  expect(ends.map(([east = 0]) => east)).toEqual([expect.closeTo(100), expect.closeTo(100)]);
  const [, tip = []] = (tick?.getGeometry() as LineString).getCoordinates();
  expect(tip[0]).toBeGreaterThan(101);
  expect(tip[1]).toBeCloseTo(200);
  expect(label?.getText()?.getText()).toBe("35");
});

test("a feature without angles is not drawn", () => {
  expect(drawDip(facet({}), 1)).toEqual([]);
});
