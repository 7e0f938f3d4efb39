/** The slider of sols over the layers: products, footprints and images of one sol, or of all; and its report. */

import { h } from "../../page/dom";
import type { Layer } from "../../server/records";

/** A sol is shown so long when they are played. */
const STEP_MS = 1500;

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
  let playing: ReturnType<typeof setInterval> | undefined;
  const stop = () => {
    clearInterval(playing);
    playing = undefined;
    play.textContent = "Play";
    play.setAttribute("aria-pressed", "false");
  };
  /** Sol after sol, and all of them at the end. */
  const step = () => {
    if (!element.isConnected) return stop();
    const next = days[days.indexOf(chosen() ?? Number.NaN) + 1] ?? null;
    set(next);
    choose(next);
    if (next === null) stop();
  };
  const toggle = () => {
    if (playing !== undefined) return stop();
    playing = setInterval(step, STEP_MS);
    play.textContent = "Stop";
    play.setAttribute("aria-pressed", "true");
    step();
  };
  const play = h(
    "button",
    {
      type: "button",
      class: "plain play",
      "aria-pressed": "false",
      title: "show sol after sol",
      hidden: days.length < 2,
      onclick: toggle,
    },
    "Play",
  );
  const choice = h("label", { class: "inline", hidden: days.length < 2 }, name, slider);
  const element = h("div", { class: "sol-filter" }, choice, play, report);
  return { element, set };
}
