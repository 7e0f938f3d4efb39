/** The kinds of measurement: what is drawn for each, and what the server makes of it. */

import { measure, measuredText, polygonArea } from "../../map/measure";
import type { Shape } from "../../map/sketch";
import { fixed } from "../../page/format";
import { type LayerUsed, measuring, type Profile } from "../../server/measure";
import type { MapPoint } from "../../server/records";
import {
  areaQuantities,
  lineQuantities,
  planeQuantities,
  type Quantity,
  volumeQuantities,
  zoneQuantities,
} from "./quantities";

/** What was found on the ground that was drawn. */
export interface Found {
  readonly quantities: readonly Quantity[];
  /** Number of the quantity that stands for all. */
  readonly main: number;
  readonly layers: readonly LayerUsed[];
  readonly note?: string | null;
  readonly profile?: Profile;
}

export type ModeKey = "distance" | "profile" | "slope" | "area" | "volume" | "plane" | "zone";

export interface Mode {
  readonly key: ModeKey;
  readonly title: string;
  readonly shape: Shape;
  /** Corners that are needed, and at which a line ends by itself. */
  readonly least: number;
  readonly most?: number;
  readonly hint: string;
  /** What is told while the shape grows. */
  readonly live: (corners: readonly MapPoint[]) => string;
  /** Whether a raster layer is to be chosen for it. */
  readonly asksLayer?: boolean;
  readonly find: (
    mission: string,
    corners: readonly MapPoint[],
    layer: string | null,
  ) => Promise<Found>;
}

const nameOf = (quantities: readonly Quantity[], name: string) =>
  Math.max(
    0,
    quantities.findIndex((one) => one.name === name),
  );

function found(
  quantities: readonly Quantity[],
  main: string,
  layers: readonly LayerUsed[],
  more: Partial<Found> = {},
): Found {
  return { quantities, main: nameOf(quantities, main), layers, ...more };
}

const length = (corners: readonly MapPoint[]) => measuredText(measure(corners));
const area = (corners: readonly MapPoint[]) =>
  corners.length < 3
    ? "click the corners; double-click ends, Esc stops"
    : `${fixed(polygonArea(corners), 2)} m² on the map`;

async function line(mission: string, corners: readonly MapPoint[], main: string): Promise<Found> {
  const answer = await measuring.line(mission, corners);
  const note = answer.ends
    ? null
    : "An end lies on ground that was not measured: no rise, no slope.";
  return found(lineQuantities(answer), main, answer.layers, { note });
}

export const MODES: readonly Mode[] = [
  {
    key: "distance",
    title: "Distance",
    shape: "line",
    least: 2,
    hint: "Click along the way; double-click ends it.",
    live: length,
    find: (mission, corners) => line(mission, corners, "length on the map"),
  },
  {
    key: "profile",
    title: "Profile",
    shape: "line",
    least: 2,
    hint: "Click along the way; the ground under it is drawn below the map with its uncertainty.",
    live: length,
    find: async (mission, corners) => {
      const [profile, whole] = await Promise.all([
        measuring.profile(mission, corners),
        measuring.line(mission, corners),
      ]);
      return found(lineQuantities(whole), "length on the map", profile.layers, { profile });
    },
  },
  {
    key: "slope",
    title: "Slope",
    shape: "line",
    least: 2,
    most: 2,
    hint: "Click two places: rise and slope from the first to the second.",
    live: length,
    find: (mission, corners) => line(mission, corners, "slope"),
  },
  {
    key: "area",
    title: "Area",
    shape: "area",
    least: 3,
    hint: "Click the corners; double-click ends it.",
    live: area,
    find: async (mission, corners) => {
      const answer = await measuring.area(mission, corners);
      return found(areaQuantities(answer), "area on the map", answer.layers);
    },
  },
  {
    key: "volume",
    title: "Volume",
    shape: "area",
    least: 3,
    hint: "Outline a rock or a hollow: its volume over the plane that fits the ground of the outline.",
    live: area,
    find: async (mission, corners) => {
      const answer = await measuring.volume(mission, corners, "rim");
      return found(volumeQuantities(answer), "net", answer.layers);
    },
  },
  {
    key: "plane",
    title: "Strike and dip",
    shape: "point",
    least: 3,
    hint: "Click three or more places of one plane; Enter ends it.",
    live: (corners) => `${corners.length} of at least 3 points`,
    find: async (mission, corners) => {
      const answer = await measuring.plane(mission, corners);
      const quantities = planeQuantities(answer);
      return found(quantities, "dip", answer.layers, { note: answer.said_of_strike });
    },
  },
  {
    key: "zone",
    title: "Statistics",
    shape: "area",
    least: 3,
    hint: "Choose a layer and outline an area: mean, spread and percentiles of the layer in it.",
    live: area,
    asksLayer: true,
    find: async (mission, corners, layer) => {
      const answer = await measuring.zone(mission, corners, layer ?? "");
      return found(zoneQuantities(answer), "mean", answer.layers);
    },
  },
];
