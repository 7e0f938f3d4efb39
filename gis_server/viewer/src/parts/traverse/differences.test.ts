import { expect, test } from "vitest";
import type { Solution, TraverseAnswer, TraverseRow } from "../../server/network";
import { differencesCsv, rowsOf, solutionTitle, summaryText } from "./differences";

const row = (
  label: string,
  sol: number,
  distance_m: number,
  horizontal_m: number,
): TraverseRow => ({
  stop: label,
  label,
  sol,
  distance_m,
  horizontal_m,
  sigma_horizontal_m: 0.04,
  sigma_north_m: 0.03,
  sigma_east_m: 0.03,
  place: [1, 2, 3],
  reference: [1, 2, null],
  offset_m: [horizontal_m, 0, null],
  percent: distance_m > 0 ? (100 * horizontal_m) / distance_m : null,
  leg_m: null,
  sigma_up_m: 0.02,
  reference_sigma_up_m: null,
  held: false,
  held_by: "",
});
const answer: TraverseAnswer = {
  solution: "mer2-sol0002/a",
  reference: "telemetry",
  rows: [row("1/0", 1, 0, 0), row("1/5", 1, 20, 1.5), row("2/0", 2, 43.5, 0.4)],
  end: 2,
  worst: 1,
  farthest: 1,
  by_sol: [1, 2],
};

test("the end and the worst are given in metres and percent, as in the paper", () => {
  expect(summaryText(answer)).toBe(
    "After 43.5 m telemetry differs by 0.40 ± 0.04 m, 0.92 %; at most by 1.50 ± 0.04 m, 7.50 % at 1/5.",
  );
});

test("by sol the last stop of every sol stands", () => {
  expect(rowsOf(answer, true).map(({ label }) => label)).toEqual(["1/5", "2/0"]);
  expect(rowsOf(answer, false)).toHaveLength(3);
});

test("a spreadsheet has every number, and nothing where nothing is known", () => {
  const [head, first] = differencesCsv(answer).split("\n");
  expect(first?.split(",")).toHaveLength(head?.split(",").length ?? 0);
  expect(first).toBe("1/0,1,0,0,,0,0,,,1,2,3,0.04,0.02,mer2-sol0002/a,telemetry");
});

test("solutions of one sol are distinguished by when they were made", () => {
  const one: Solution = {
    id: "a",
    sol: 157,
    digest: "a",
    is_overall: false,
    is_latest: true,
    made_at: "2026-11-22T00:01:32+00:00",
  };
  expect(solutionTitle(one, [one])).toBe("sol 157 (on the map)");
  const older = { ...one, id: "b", is_latest: false };
  expect(solutionTitle(older, [one, older])).toBe("sol 157, made 2026-11-22 00:01");
  const overall = { ...older, is_overall: true };
  expect(solutionTitle(overall, [one, older, overall])).toBe("sol 157, overall");
});
