/** The range of sols: a first and a last one. They can be played one after the other. */

import type Feature from "ol/Feature";
import type Point from "ol/geom/Point";
import type Geometry from "ol/geom/Geometry";
import { type Sols, solsTitle } from "../../map/sols";
import { placeKey } from "../../map/styles";
import { h } from "../../page/dom";
import type { Layer } from "../../server/records";

/** Duration of a sol in the playback. */
const STEP_MS = 1500;

export interface SolActions {
  readonly reportOf: (sol: number) => string;
  readonly choose: (range: Sols) => void;
  /** Saves the maps of these ranges, one after the other, as an animation. */
  readonly record: (steps: readonly Sols[]) => void;
}

export interface SolFilter {
  readonly element: HTMLElement;
  readonly set: (range: Sols) => void;
}

export function solsOf(layers: readonly Layer[]): readonly number[] {
  return [...new Set(layers.flatMap(({ sols }) => [...sols]))].sort((a, b) => a - b);
}

/** Sols of stops by `placeKey`. */
export const solsByPlace = (
  stops: readonly Feature<Geometry>[],
): ReadonlyMap<string, readonly number[]> =>
  new Map(
    stops.map((stop) => {
      const place = (stop.getGeometry() as Point).getCoordinates();
      return [placeKey(place), (stop.get("sols") as readonly number[] | undefined) ?? []] as const;
    }),
  );

/** Steps of the playback: every sol of a range alone, or all up to it. */
export function stepsOf(days: readonly number[], range: Sols, isGrowing: boolean): readonly Sols[] {
  const [from = 0, to = 0] = range ?? [days[0], days.at(-1)];
  return days
    .filter((day) => from <= day && day <= to)
    .map((day): Sols => [isGrowing ? from : day, day]);
}

export function solFilter(days: readonly number[], actions: SolActions): SolFilter {
  const { reportOf, choose, record } = actions;
  const last = Math.max(0, days.length - 1);
  const name = h("output", {}, "all sols");
  const report = h("a", { class: "text sol-report", target: "_blank", hidden: true });
  const slider = (title: string, value: number) =>
    h("input", {
      type: "range",
      min: 0,
      max: last,
      step: 1,
      value,
      "aria-label": title,
      oninput: (event) => chosen(event.target as HTMLInputElement),
    });
  const [first, final] = [slider("first sol", 0), slider("last sol", last)];
  const ends = [first, final] as const;
  const range = (): Sols => {
    const [from, to] = ends.map(({ value }) => Number(value)) as [number, number];
    if (from === 0 && to === last) return null;
    return [days[from] ?? 0, days[to] ?? 0];
  };
  /** The other end of the range is moved if necessary. */
  const chosen = (moved: HTMLInputElement) => {
    if (Number(first.value) > Number(final.value))
      for (const end of ends) if (end !== moved) end.value = moved.value;
    stop();
    choose(range());
  };
  const set = (sols: Sols) => {
    const [from, to] = sols ?? [days[0] ?? 0, days.at(-1) ?? 0];
    const at = [days.findIndex((day) => day >= from), days.findLastIndex((day) => day <= to)];
    ends.forEach((end, k) => {
      end.value = String(Math.max(0, at[k] ?? 0));
      end.setAttribute("aria-valuetext", `sol ${days[Number(end.value)]}`);
    });
    name.textContent = solsTitle(sols);
    const [only = null] = days.length === 1 ? days : [];
    const singleSol = sols && sols[0] === sols[1] ? sols[0] : only;
    report.hidden = singleSol === null;
    if (singleSol === null) return;
    report.href = reportOf(singleSol);
    report.textContent = `report of sol ${singleSol}`;
  };

  const growing = h("input", { type: "checkbox", "aria-label": "keep earlier sols" });
  let playing: ReturnType<typeof setInterval> | undefined;
  const stop = () => {
    clearInterval(playing);
    playing = undefined;
    play.textContent = "Play";
    play.setAttribute("aria-pressed", "false");
  };
  /** Plays the steps, and restores the earlier choice at the end. */
  const start = () => {
    const before = range();
    const steps = [...stepsOf(days, before, growing.checked), before];
    const next = () => {
      if (!element.isConnected) return stop();
      choose(steps.shift() ?? null);
      if (steps.length === 0) stop();
    };
    playing = setInterval(next, STEP_MS);
    play.textContent = "Stop";
    play.setAttribute("aria-pressed", "true");
    next();
  };
  const play = h(
    "button",
    {
      type: "button",
      class: "plain play",
      "aria-pressed": "false",
      title: "show sol after sol",
      onclick: () => (playing === undefined ? start() : stop()),
    },
    "Play",
  );
  const save = h(
    "button",
    {
      type: "button",
      class: "plain save",
      title: "save the playback as a video or GIF",
      onclick: () => record(stepsOf(days, range(), growing.checked)),
    },
    "Save…",
  );
  const element = h(
    "div",
    { class: "sol-filter" },
    h("div", { class: "sol-summary" }, days.length < 2 ? null : name, report),
    h(
      "div",
      { class: "sol-range", hidden: days.length < 2 },
      ...[h("span", {}, "from"), first, h("span", {}, "to"), final],
    ),
    h(
      "div",
      { class: "inline", hidden: days.length < 2 },
      play,
      h("label", { class: "inline" }, growing, "keep earlier"),
      save,
    ),
  );
  return { element, set };
}
