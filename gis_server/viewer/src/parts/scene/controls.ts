/** What can be chosen beside the 3D view. No knowledge of how it is drawn. */

import type { SunPlace } from "../../map/shading";
import { h } from "../../page/dom";

export interface Choices {
  /** Ground and cameras of one stop; null for all stops' ground. */
  stop: string | null;
  look: "photograph" | "lit" | "relief";
  exaggeration: number;
  rover: boolean;
  cameras: boolean;
  traverse: boolean;
  ellipsoids: boolean;
  ties: boolean;
  views: boolean;
  ground: boolean;
  points: boolean;
  /** Of a point, screen pixels. */
  pointSize: number;
  anaglyph: boolean;
}

export const FIRST: Choices = {
  stop: null,
  look: "photograph",
  exaggeration: 1,
  rover: true,
  cameras: true,
  traverse: true,
  ellipsoids: true,
  ties: false,
  views: false,
  ground: true,
  points: false,
  pointSize: 2,
  anaglyph: false,
};

export interface Actions {
  readonly changed: (choices: Readonly<Choices>, name: keyof Choices) => void;
  readonly lit: (sun: SunPlace) => void;
  readonly overview: () => void;
  readonly stand: () => void;
  readonly fullScreen: () => void;
}

export interface Board {
  readonly element: HTMLElement;
  readonly choices: Readonly<Choices>;
  /** The sun was moved elsewhere. */
  readonly putSun: (sun: SunPlace) => void;
}

const SWITCHES = [
  ["rover", "rover"],
  ["cameras", "cameras"],
  ["traverse", "traverse"],
  ["ellipsoids", "error ellipsoids"],
  ["ties", "tie points"],
  ["views", "what pairs see"],
  ["ground", "terrain model"],
  ["points", "dense points"],
  ["anaglyph", "red-cyan"],
] as const;
const LOOKS = [
  ["photograph", "as photographed"],
  ["lit", "photograph, lit by the sun"],
  ["relief", "relief, lit by the sun"],
] as const;

export function controls(
  stops: readonly (readonly [stop: string, title: string])[],
  sun: SunPlace,
  actions: Actions,
): Board {
  const choices = { ...FIRST };
  const set = <K extends keyof Choices>(name: K, value: Choices[K]) => {
    choices[name] = value;
    actions.changed(choices, name);
  };
  const stop = h(
    "select",
    { "aria-label": "stop", name: "stop", onchange: () => set("stop", stop.value || null) },
    h("option", { value: "" }, "all stops"),
    ...stops.map(([id, title]) => h("option", { value: id }, title)),
  );
  const look = h(
    "select",
    {
      "aria-label": "look of the ground",
      name: "look",
      onchange: () => set("look", look.value as Choices["look"]),
    },
    ...LOOKS.map(([value, title]) => h("option", { value }, title)),
  );
  const slider = (
    name: string,
    title: string,
    [min, max, step]: readonly [least: number, most: number, step: number],
    unit: string,
    first: number,
    change: (value: number) => void,
  ) => {
    const value = h("output", {}, `${first}${unit}`);
    const input = h("input", {
      type: "range",
      name,
      min,
      max,
      step,
      value: first,
      oninput: () => {
        value.textContent = `${input.value}${unit}`;
        change(Number(input.value));
      },
    });
    const put = (to: number) => {
      input.value = String(to);
      value.textContent = `${Math.round(to)}${unit}`;
    };
    return { put, row: h("label", { class: "inline" }, h("span", {}, title), input, value) };
  };
  const heights = slider("exaggeration", "vertical exaggeration", [1, 5, 0.5], " ×", 1, (factor) =>
    set("exaggeration", factor),
  );
  const points = slider("pointSize", "point size", [1, 8, 1], " px", FIRST.pointSize, (size) =>
    set("pointSize", size),
  );
  let shining = sun;
  const shine = (part: Partial<SunPlace>) => actions.lit({ ...shining, ...part });
  const from = slider("azimuth", "sun from", [0, 355, 5], "°", sun.azimuthDeg, (azimuthDeg) =>
    shine({ azimuthDeg }),
  );
  const above = slider(
    "elevation",
    "sun above",
    [1, 90, 1],
    "°",
    sun.elevationDeg,
    (elevationDeg) => shine({ elevationDeg }),
  );
  const putSun = (to: SunPlace) => {
    shining = to;
    from.put(to.azimuthDeg);
    above.put(to.elevationDeg);
  };
  const toggles = SWITCHES.map(([name, title]) => {
    const input = h("input", {
      type: "checkbox",
      name,
      checked: FIRST[name],
      onchange: () => set(name, input.checked),
    });
    return h("label", {}, input, title);
  });
  const act = (name: string, title: string, run: () => void) =>
    h("button", { type: "button", class: "plain", name, onclick: run }, title);
  const element = h(
    "form",
    { class: "scene-controls", onsubmit: (event) => event.preventDefault() },
    h("div", { class: "row" }, stop, look),
    h(
      "div",
      { class: "row" },
      act("overview", "overview", actions.overview),
      act("stand", "stand at the stop", actions.stand),
      act("full", "full screen", actions.fullScreen),
    ),
    h("div", { class: "row switches" }, ...toggles),
    heights.row,
    points.row,
    from.row,
    above.row,
  );
  return { element, choices, putSun };
}
