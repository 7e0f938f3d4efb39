/** The slider of sols over the layers: products, footprints and images of one sol, or of all; and its report. */

import { h } from "../../page/dom";
import type { Layer } from "../../server/records";

export interface SolFilter {
  readonly element: HTMLElement;
  readonly set: (sol: number | null) => void;
}

export function solsOf(layers: readonly Layer[]): readonly number[] {
  return [...new Set(layers.flatMap(({ sols }) => [...sols]))].sort((a, b) => a - b);
}

export function solFilter(
  days: readonly number[],
  reportOf: (sol: number) => string,
  choose: (sol: number | null) => void,
): SolFilter {
  const name = h("output", {}, "all sols");
  const chosen = () => days[Number(slider.value) - 1] ?? null;
  const report = h("a", { class: "sol-report", target: "_blank", hidden: true });
  const say = (sol: number | null) => {
    name.textContent = sol === null ? "all sols" : `sol ${sol}`;
    slider.setAttribute("aria-valuetext", name.textContent);
    const [only = null] = days.length === 1 ? days : [];
    const told = sol ?? only;
    report.hidden = told === null;
    if (told === null) return;
    report.href = reportOf(told);
    report.textContent = `report of sol ${told}`;
  };
  const slider = h("input", {
    type: "range",
    class: "sol-of-layers",
    min: 0,
    max: days.length,
    step: 1,
    value: 0,
    "aria-label": "sol of layers",
    oninput: () => {
      say(chosen());
      choose(chosen());
    },
  });
  const set = (sol: number | null) => {
    slider.value = String(sol === null ? 0 : days.indexOf(sol) + 1);
    say(sol);
  };
  const choice = h("label", { class: "inline", hidden: days.length < 2 }, name, slider);
  const element = h("div", { class: "sol-filter" }, choice, report);
  return { element, set };
}
