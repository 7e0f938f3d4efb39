/** The vertical profile below the map: distance against elevation by both solutions, and the ground between. */

import { ADJUSTED, TELEMETRY } from "../../map/styles";
import { type Chart, chart, type Series } from "../../page/chart";
import { HELD_M, measured } from "../../page/format";
import type { TraverseAnswer } from "../../server/network";
import type { Profile } from "../../server/measure";
import { summaryText, TELEMETRY_NAME } from "./differences";

const GROUND = "#8a8578";

/** Both solutions by the distance along the first; the reference starts at the same height. */
export function profileSeries(answer: TraverseAnswer, ground: Profile | null): Series[] {
  const { rows, reference } = answer;
  const xs = rows.map(({ distance_m }) => distance_m);
  const raised = rows.map(({ place, offset_m }) =>
    place[2] === null || offset_m[2] === null ? null : place[2] + offset_m[2],
  );
  const isTelemetry = reference === TELEMETRY_NAME;
  const both: Series[] = [
    {
      name: isTelemetry ? "telemetry" : "other solution",
      colour: isTelemetry ? TELEMETRY : "#7a7a7a",
      xs,
      ys: raised,
      isDashed: true,
      hasDots: true,
      ...(isTelemetry ? {} : { sigma: rows.map((row) => row.reference_sigma_up_m) }),
    },
    {
      name: "adjusted",
      colour: ADJUSTED,
      xs,
      ys: rows.map(({ place }) => place[2]),
      sigma: rows.map(({ sigma_up_m }) => sigma_up_m),
      hasDots: true,
    },
  ];
  if (!ground) return both;
  const below: Series = {
    name: "ground below",
    colour: GROUND,
    xs: ground.distance_m,
    ys: ground.elevation_m,
    sigma: ground.sigma_m,
  };
  return [below, ...both];
}

export function profileSummary(answer: TraverseAnswer): string {
  const end = answer.rows[answer.end];
  const height = end?.offset_m[2];
  const up =
    height === null || height === undefined
      ? ""
      : ` In height it ends ${measured(height, "m", end?.sigma_up_m, HELD_M)} off.`;
  return `${summaryText(answer)}${up} Bands are one sigma; elevations are of the rover's origin.`;
}

export function profileChart(
  answer: TraverseAnswer,
  ground: Profile | null,
  onCursor: (distance_m: number | null) => void,
): Chart {
  return chart({
    title: "Vertical profile of the traverse",
    summary: profileSummary(answer),
    x: { title: "distance travelled", unit: "m", decimals: 1 },
    y: { title: "elevation", unit: "m", decimals: 2 },
    series: profileSeries(answer, ground),
    onCursor,
  });
}
