/** The kinds of measurement: the shape drawn for each, and the request to the server. */

import { measure, measuredText, polygonArea } from "../../map/measure";
import { compact } from "../../page/format";
import { measuring } from "../../server/measure";
import type { MapPoint } from "../../server/records";
import { DRIVE_MODES } from "./drive-modes";
import { found, type Found, type Mode } from "./mode";
import {
  areaQuantities,
  lineQuantities,
  planeQuantities,
  volumeQuantities,
  zoneQuantities,
} from "./quantities";
import { SIGHT_MODES } from "./sight-modes";

const length = (corners: readonly MapPoint[]) => measuredText(measure(corners));
const area = (corners: readonly MapPoint[]) =>
  corners.length < 3
    ? "click the corners; double-click or Enter ends, Esc stops"
    : `${compact(polygonArea(corners), 3)} m² on the map`;

async function line(mission: string, corners: readonly MapPoint[], main: string): Promise<Found> {
  const answer = await measuring.line(mission, corners);
  const note = answer.ends
    ? null
    : "An end lies on ground that was not measured: no rise, no slope.";
  return found(lineQuantities(answer, corners), main, answer.layers, { note });
}

export const MODES: readonly Mode[] = [
  {
    key: "distance",
    title: "Distance",
    shape: "line",
    least: 2,
    hint: "Click along the way; double-click or Enter ends it.",
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
      return found(lineQuantities(whole, corners), "length on the map", profile.layers, {
        profile,
      });
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
    hint: "Click the corners; double-click or Enter ends it.",
    live: area,
    find: async (mission, corners) => {
      const answer = await measuring.area(mission, corners);
      return found(areaQuantities(answer, corners), "area on the map", answer.layers);
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
      return found(volumeQuantities(answer, corners), "net", answer.layers);
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
    needsLayer: true,
    find: async (mission, corners, { layer }) => {
      const answer = await measuring.zone(mission, corners, layer ?? "");
      return found(zoneQuantities(answer), "mean", answer.layers);
    },
  },
  ...SIGHT_MODES,
  ...DRIVE_MODES,
];
