/** The slider of sols over the layers: products, footprints and images of one sol, or of all. */

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
  choose: (sol: number | null) => void,
): SolFilter {
  const name = h("output", {}, "all sols");
  const chosen = () => days[Number(slider.value) - 1] ?? null;
  const say = (sol: number | null) => {
    name.textContent = sol === null ? "all sols" : `sol ${sol}`;
    slider.setAttribute("aria-valuetext", name.textContent);
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
  const element = h("label", { class: "inline sol-filter", hidden: days.length < 2 }, name, slider);
  return { element, set };
}
