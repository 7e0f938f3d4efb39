/** Visibility: a line of sight between two places, and the ground that is seen from one. */

import { countedSigma, measure, measuredText } from "../../map/measure";
import { measured } from "../../page/format";
import { sight, type SightLine, type Viewshed } from "../../server/sight";
import type { MapPoint } from "../../server/records";
import { found, type Found, type Mode, type NumberField } from "./mode";
import { cellOf, decimalsOn, type Quantity } from "./quantities";

const GROUND = "#c2571b";
const LINE = "#1769e0";

const height = (key: string, title: string, usual: number): NumberField => ({
  key,
  title,
  usual,
  least: 0,
  most: 100,
  step: 0.1,
});
/** Defaults of the server: the mast of MER, and a stone. */
const EYE = height("eye_m", "eye above the ground", 1.5);
const TARGET = height("target_m", "target above the ground", 0.1);
const RADIUS: NumberField = {
  key: "radius_m",
  title: "radius",
  usual: 50,
  least: 1,
  most: 2000,
  step: 1,
};

export const SIGHT_WORDS = { visible: "free", hidden: "blocked", unknown: "not known" } as const;

export function sightQuantities(line: SightLine): Quantity[] {
  const { obstruction, obstruction_distance_m, clearance_m } = line;
  const one = (name: string, value: number | null): Quantity => {
    return { name, value, resolution: cellOf(line.layers), unit: "m" };
  };
  const inTheWay: Quantity[] = obstruction
    ? [
        one("blocked after", obstruction_distance_m),
        one("blocked at east", obstruction[0]),
        one("blocked at north", obstruction[1]),
        one("elevation there", obstruction[2]),
      ]
    : [];
  return [
    { name: "line of sight", value: null, word: SIGHT_WORDS[line.sight], unit: "" },
    one("least height over the ground", clearance_m),
    ...inTheWay,
    one("longest unmapped stretch", line.unseen_m),
    one("length on the map", line.map_distance_m),
  ];
}

/** The ground below a line of sight, and the line. */
export function sightChart(line: SightLine): NonNullable<Found["chart"]> {
  const { distance_m: xs, sight: seen, clearance_m } = line;
  const room =
    clearance_m === null
      ? "No ground is mapped on the way."
      : `It runs ${measured(Math.abs(clearance_m), "m", null, cellOf(line.layers))} ${clearance_m < 0 ? "below" : "above"} the ground that obstructs it most.`;
  return {
    title: "Line of sight",
    summary: `The line of sight is ${SIGHT_WORDS[seen]}. ${room}`,
    x: { title: "distance", unit: "m", decimals: decimalsOn(line.layers) },
    y: { title: "elevation", unit: "m", decimals: decimalsOn(line.layers) },
    series: [
      { name: "ground", colour: GROUND, xs, ys: line.ground_m },
      { name: "line of sight", colour: LINE, xs, ys: line.line_m, isDashed: true },
    ],
  };
}

function sightFound(line: SightLine): Found {
  const { obstruction } = line;
  const mark: MapPoint | null = obstruction && [obstruction[0], obstruction[1]];
  const note =
    line.sight === "unknown" ? "Too much of the line lies over unseen ground to decide." : null;
  const quantities = sightQuantities(line);
  return found(quantities, "line of sight", line.layers, { chart: sightChart(line), mark, note });
}

const counted = (name: string, value: number, cell_m: number): Quantity => {
  return { name, value, resolution: countedSigma(value, cell_m), unit: "m²" };
};

export const viewshedQuantities = (seen: Viewshed): Quantity[] => [
  counted("ground seen", seen.visible_m2, seen.cell_m),
  counted("ground hidden", seen.hidden_m2, seen.cell_m),
  counted("not known", seen.unknown_m2, seen.cell_m),
  {
    name: "elevation of the eye",
    value: seen.eye_elevation_m,
    resolution: cellOf(seen.layers),
    unit: "m",
  },
  { name: "radius", value: seen.radius_m, unit: "m" },
  { name: "cell", value: seen.cell_m, unit: "m" },
];

function viewshedFound(seen: Viewshed): Found {
  const { picture: url, bounds, geotiff } = seen;
  return found(viewshedQuantities(seen), "ground seen", seen.layers, {
    note: "On the map: blue is seen, brown is hidden; of ground without colour nothing is known.",
    overlay: { url, bounds, geotiff },
  });
}

export const SIGHT_MODES: readonly Mode[] = [
  {
    key: "sight",
    title: "Line of sight",
    shape: "line",
    least: 2,
    most: 2,
    hint: "Click the eye's place, then the target: the result states whether ground between obstructs the view.",
    live: (corners) => measuredText(measure(corners)),
    numberFields: [EYE, TARGET],
    find: async (mission, corners, { numbers }) => {
      const [eye, target] = corners;
      if (!eye || !target) throw new Error("a line of sight has two ends");
      const [eye_m, target_m] = [numbers.eye_m ?? EYE.usual, numbers.target_m ?? TARGET.usual];
      return sightFound(await sight.line(mission, eye, target, eye_m, target_m));
    },
  },
  {
    key: "viewshed",
    title: "Viewshed",
    shape: "point",
    least: 1,
    most: 1,
    hint: "Click the place of a mast: the ground visible from its top is overlaid on the map.",
    live: () => "click a place, Esc stops",
    numberFields: [{ ...EYE, key: "mast_m", title: "mast above the ground" }, TARGET, RADIUS],
    find: async (mission, corners, { numbers }) => {
      const [place] = corners;
      if (!place) throw new Error("a viewshed is of a place");
      const query = {
        mast_m: numbers.mast_m ?? EYE.usual,
        target_m: numbers.target_m ?? TARGET.usual,
        radius_m: numbers.radius_m ?? RADIUS.usual,
      };
      return viewshedFound(await sight.viewshed(mission, place, query));
    },
  },
];
