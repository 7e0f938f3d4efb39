/**
 * The table of accumulated differences (Di et al. 2008, section 3.3): metres, percent of the distance, their maximum.
 */

import { h } from "../../page/dom";
import { digits, HELD_M, measured, percentText } from "../../page/format";
import type { Solution, TraverseAnswer, TraverseRow } from "../../server/network";

export const TELEMETRY_NAME = "telemetry";

/** `sol 157`, `sol 157, overall`; with the time it was made where several are of one sol. */
export function solutionTitle(one: Solution, all: readonly Solution[]): string {
  const name = `sol ${one.sol}${one.is_overall ? ", overall" : ""}`;
  const sameTitle = all.filter(
    ({ sol, is_overall }) => sol === one.sol && is_overall === one.is_overall,
  );
  const made = sameTitle.length > 1 ? `, made ${one.made_at.slice(0, 16).replace("T", " ")}` : "";
  return `${name}${made}${one.is_latest ? " (on the map)" : ""}`;
}

/** The result for a traverse in one sentence, as in the paper. */
export function summaryText(answer: TraverseAnswer): string {
  const [end, worst] = [answer.rows[answer.end], answer.rows[answer.worst]];
  if (!end || !worst) return "";
  const at = (row: TraverseRow) =>
    `${measured(row.horizontal_m, "m", row.sigma_horizontal_m, HELD_M)}, ${percentText(row)}`;
  return (
    `After ${measured(end.distance_m, "m", null, 0.1)} ${answer.reference === TELEMETRY_NAME ? "telemetry" : "the other solution"} ` +
    `differs by ${at(end)}; at most by ${at(worst)} at ${worst.label}.`
  );
}

/** Rows of all stops, or of the last stop of every sol. */
export function rowsOf(answer: TraverseAnswer, bySol: boolean): readonly TraverseRow[] {
  if (!bySol) return answer.rows;
  return answer.by_sol.flatMap((k) => answer.rows[k] ?? []);
}

const COLUMNS = ["stop", "sol", "distance", "2D error", "percent", "vertical"] as const;

export function differenceTable(
  answer: TraverseAnswer,
  bySol: boolean,
  goTo: (row: TraverseRow) => void,
): HTMLElement {
  const marks = new Map([
    [answer.rows[answer.worst], "most percent"],
    [answer.rows[answer.farthest], "most metres"],
  ]);
  const line = (row: TraverseRow) =>
    h(
      "tr",
      { "data-row": row.label, class: marks.has(row) ? "most" : "", title: marks.get(row) ?? null },
      h(
        "td",
        {},
        h("button", { type: "button", class: "link", onclick: () => goTo(row) }, row.label),
      ),
      h("td", { class: "number" }, String(row.sol)),
      h("td", { class: "number" }, digits(row.distance_m, null, 0.1)),
      h("td", { class: "number" }, digits(row.horizontal_m, row.sigma_horizontal_m, HELD_M)),
      h("td", { class: "number" }, percentText(row)),
      h("td", { class: "number" }, digits(row.offset_m[2], row.sigma_up_m, HELD_M)),
    );
  return h(
    "table",
    { class: "values differences" },
    h("thead", {}, h("tr", {}, ...COLUMNS.map((name) => h("th", { scope: "col" }, name)))),
    h("tbody", {}, ...rowsOf(answer, bySol).map(line)),
  );
}

/** The differences as a table for spreadsheets. */
export function differencesCsv({ rows, solution, reference }: TraverseAnswer): string {
  const head =
    "stop,sol,distance_m,horizontal_m,percent,east_m,north_m,up_m,leg_m,east,north,elevation_m,sigma_horizontal_m,sigma_up_m,solution,reference";
  const lines = rows.map((row) =>
    [
      row.label,
      row.sol,
      row.distance_m,
      row.horizontal_m,
      row.percent,
      ...row.offset_m,
      row.leg_m,
      ...row.place,
      row.sigma_horizontal_m,
      row.sigma_up_m,
      solution,
      reference,
    ]
      .map((value) => value ?? "")
      .join(","),
  );
  return [head, ...lines, ""].join("\n");
}
