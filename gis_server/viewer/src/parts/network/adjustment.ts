/** Figures of the adjustment. */

import { facts, h } from "../../page/dom";
import { compact, metres } from "../../page/format";
import type { Agreement, NetworkGraph, TieKind } from "../../server/network";

const KINDS: Readonly<Record<TieKind, string>> = {
  "intra-stereo": "within pairs",
  "inter-stereo": "between pairs",
  "cross-site": "between stops",
};

const count = (number: number, one: string) =>
  `${number.toLocaleString("en")} ${one}${number === 1 ? "" : "s"}`;

function agreement({ mean_2d_px, mean_3d_m }: Agreement): string {
  const inImages = mean_2d_px === null ? [] : [`${compact(mean_2d_px, 2)} px`];
  return [...(mean_3d_m === null ? [] : [metres(mean_3d_m, 2)]), ...inImages].join(", ");
}

export function adjustmentFacts({
  stops,
  adjustment,
}: Pick<NetworkGraph, "stops" | "adjustment">): (readonly [string, string])[] {
  const { pairs, ties, blunders, sigma0, control, before, after, message } = adjustment;
  const used = Object.entries(KINDS).map(
    ([kind, where]) => `${(ties[kind as TieKind] ?? 0).toLocaleString("en")} ${where}`,
  );
  const [was, is] = [before["cross-site"], after["cross-site"]];
  const change = was && is?.comparisons ? `${agreement(was)} → ${agreement(is)}` : "";
  return [
    ["network", `${count(stops.length, "stop")}, ${count(pairs, "pair")}`],
    ["tie points used", used.join(", ")],
    ["blunders", `${count(blunders, "observation")} set aside`],
    ["σ₀", sigma0 === null ? "" : `${compact(sigma0, 3)} (1: stated standard deviations are true)`],
    ["stops differ by", change],
    ["control", control > 0 ? count(control, "position") : ""],
    ["remark", message],
  ];
}

/** The adjustment as a table; in a sentence what makes it unusable. */
export function adjustmentSummary(graph: NetworkGraph): HTMLElement[] {
  const { converged, iterations, redundancy } = graph.adjustment;
  if (redundancy === 0)
    return [h("p", {}, "No tie points: the positions of all stops are those of telemetry.")];
  const trouble = `The adjustment did not converge in ${count(iterations, "iteration")}.`;
  return [
    ...(converged ? [] : [h("p", { class: "error" }, trouble)]),
    facts(adjustmentFacts(graph)),
  ];
}
