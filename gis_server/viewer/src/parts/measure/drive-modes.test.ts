import { expect, test } from "vitest";
import type { Reachable, Route } from "../../server/driving";
import { longestWay, reachQuantities, routeChart, routeQuantities } from "./drive-modes";
import { quantityText } from "./quantities";

const LAYER = { id: "mer2/hazard", kind: "hazard", digest: "0123", cell_m: 0.16 };

test("a reach gives its ground, its longest drive and the duration of that", () => {
  const reach: Reachable = {
    farthest_m: 50,
    interval_m: 5,
    cell_m: 0.16,
    reached_m2: 1234.5,
    longest_drive_m: 49.5,
    longest_drive_h: 1.25,
    speed_m_h: 36,
    bounds: [-50, -50, 50, 50],
    picture: "/reach.png",
    geotiff: "/reach.tif",
    layers: [LAYER],
  };
  expect(reachQuantities(reach).map((one) => `${one.name}: ${quantityText(one)}`)).toEqual([
    "ground reached: 1234.5 m²",
    "longest drive: 49.5 m",
    "time at 36 m an hour: 1.25 h",
    "isochrones every: 5 m",
    "cell: 0.16 m",
  ]);
});

test("a route gives its length on the ground and its climb, and draws the ground", () => {
  const route: Route = {
    drive_m: 22.5,
    straight_m: 20,
    climb_m: 1.5,
    descent_m: 0.25,
    drive_h: 0.75,
    speed_m_h: 36,
    places: [
      [0, 0],
      [20, 0],
    ],
    distance_m: [0, 22.5],
    ground_m: [1, null],
    layers: [LAYER],
  };
  expect(routeQuantities(route).map((one) => `${one.name}: ${quantityText(one)}`)).toEqual([
    "drive: 22.5 m",
    "time at 36 m an hour: 0.75 h",
    "straight on the map: 20.0 m",
    "climb: 1.5 m",
    "descent: 0.3 m",
  ]);
  expect(routeChart(route).summary).toBe("A drive of 22.5 m, 1.5 m up and 0.3 m down.");
});

test("ways are looked for with room for detours, within what the server allows", () => {
  expect(longestWay(2)).toBe(50);
  expect(longestWay(60)).toBe(180);
  expect(longestWay(400)).toBe(500);
});
