/** Driving: distances of a rover to the ground around a place, and routes to another place. */

import { countedSigma, measure, measuredText } from "../../map/measure";
import { measured } from "../../page/format";
import { driving, type Reachable, type Route } from "../../server/driving";
import { found, type Found, type Mode, type NumberField } from "./mode";
import { cellOf, decimalsOn, type Quantity } from "./quantities";

const GROUND = "#c2571b";
/** Longest route of the search, as a factor of the straight line. */
const DETOUR = 3;
const LONGEST_M = 500;

const metres = (key: string, title: string, usual: number, least: number, most: number) =>
  ({ key, title, usual, least, most, step: least }) satisfies NumberField;
const FARTHEST = metres("farthest_m", "longest drive", 50, 1, LONGEST_M);
const INTERVAL = metres("interval_m", "isochrones every", 5, 0.5, LONGEST_M);
const GAP: NumberField = {
  key: "gap_m",
  title: "unknown ground driven over",
  usual: 0.5,
  least: 0,
  most: 5,
  step: 0.1,
};

const hours = (value: number, metresAnHour: number): Quantity => ({
  name: `time at ${measured(metresAnHour, "m", null, 1)} an hour`,
  value,
  resolution: 0.01,
  unit: "h",
});

export const reachQuantities = (reach: Reachable): Quantity[] => [
  {
    name: "ground reached",
    value: reach.reached_m2,
    resolution: countedSigma(reach.reached_m2, reach.cell_m),
    unit: "m²",
  },
  {
    name: "longest drive",
    value: reach.longest_drive_m,
    resolution: reach.cell_m,
    unit: "m",
  },
  hours(reach.longest_drive_h, reach.speed_m_h),
  { name: "isochrones every", value: reach.interval_m, unit: "m" },
  { name: "cell", value: reach.cell_m, unit: "m" },
];

export const routeQuantities = (route: Route): Quantity[] => [
  { name: "drive", value: route.drive_m, resolution: cellOf(route.layers), unit: "m" },
  hours(route.drive_h, route.speed_m_h),
  {
    name: "straight on the map",
    value: route.straight_m,
    resolution: cellOf(route.layers),
    unit: "m",
  },
  { name: "climb", value: route.climb_m, resolution: cellOf(route.layers), unit: "m" },
  { name: "descent", value: route.descent_m, resolution: cellOf(route.layers), unit: "m" },
];

const lengthOf = (route: Route, name: "drive_m" | "climb_m" | "descent_m") =>
  measured(route[name], "m", null, cellOf(route.layers));

/** The ground below the wheels. */
export const routeChart = (route: Route): NonNullable<Found["chart"]> => ({
  title: "Ground along the drive",
  summary: `A drive of ${lengthOf(route, "drive_m")}, ${lengthOf(route, "climb_m")} up and ${lengthOf(route, "descent_m")} down.`,
  x: { title: "driven", unit: "m", decimals: decimalsOn(route.layers) },
  y: { title: "elevation", unit: "m", decimals: decimalsOn(route.layers) },
  series: [{ name: "ground", colour: GROUND, xs: route.distance_m, ys: route.ground_m }],
});

function reachFound(reach: Reachable): Found {
  const { picture: url, bounds, geotiff } = reach;
  return found(reachQuantities(reach), "ground reached", reach.layers, {
    note: "On the map: yellow is near, blue is far; to ground without colour no safe way is known.",
    overlay: { url, bounds, geotiff },
  });
}

const routeFound = (route: Route): Found =>
  found(routeQuantities(route), "drive", route.layers, {
    chart: routeChart(route),
    way: route.places,
  });

/** Longest route between two places on the map. */
export const longestWay = (straight_m: number) =>
  Math.min(LONGEST_M, Math.max(FARTHEST.usual, DETOUR * straight_m));

export const DRIVE_MODES: readonly Mode[] = [
  {
    key: "reach",
    title: "Reachability",
    shape: "point",
    least: 1,
    most: 1,
    hint: "Click where the rover stands: how far it drives to the ground around it, past all hazards.",
    live: () => "click a place, Esc stops",
    numberFields: [FARTHEST, INTERVAL, GAP],
    find: async (mission, corners, { numbers }) => {
      const [place] = corners;
      if (!place) throw new Error("a reach is of a place");
      const query = {
        farthest_m: numbers.farthest_m ?? FARTHEST.usual,
        interval_m: numbers.interval_m ?? INTERVAL.usual,
        gap_m: numbers.gap_m ?? GAP.usual,
      };
      return reachFound(await driving.reach(mission, place, query));
    },
  },
  {
    key: "route",
    title: "Route",
    shape: "line",
    least: 2,
    most: 2,
    hint: "Click where the rover stands, then where it is to go: the shortest way past all hazards.",
    live: (corners) => measuredText(measure(corners)),
    numberFields: [GAP],
    find: async (mission, corners, { numbers }) => {
      const [from, to] = corners;
      if (!from || !to) throw new Error("a route has two ends");
      const longest = longestWay(Math.hypot(to[0] - from[0], to[1] - from[1]));
      const gap = numbers.gap_m ?? GAP.usual;
      return routeFound(await driving.route(mission, from, to, gap, longest));
    },
  },
];
