/** Clicked corners, and measurements from them without mapped ground. */

import { measure, polygonArea } from "../../map/measure";
import type { MapPoint } from "../../server/records";
import { isRefusal } from "../../session/latest";
import type { Found, Mode } from "./mode";

/** Corners without repetitions: a double-click sets two. */
export function withoutRepeats(corners: readonly MapPoint[]): MapPoint[] {
  return corners.filter(([east, north], k) => {
    const before = corners[k - 1];
    return !before || before[0] !== east || before[1] !== north;
  });
}

/** Lengths and areas on the map, for places without mapped ground. */
export async function orPlanar(
  mode: Mode,
  corners: readonly MapPoint[],
  request: Promise<Found>,
): Promise<Found> {
  try {
    return await request;
  } catch (reason) {
    if (!isRefusal(reason) || !["distance", "area"].includes(mode.key)) throw reason;
    const { length_m, azimuth_deg } = measure(corners);
    const note = "No ground was mapped here: the values are those of the map plane.";
    const quantities =
      mode.key === "area"
        ? [{ name: "area on the map", value: polygonArea(corners), unit: "m²" as const }]
        : [
            { name: "length on the map", value: length_m, unit: "m" as const },
            { name: "azimuth of the last leg", value: azimuth_deg, unit: "°" as const },
          ];
    return { quantities, main: 0, layers: [], note };
  }
}
