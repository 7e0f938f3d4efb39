/** Controls of the 3D view, independent of its drawing. */

import type { SunPlace } from "../../map/shading";
import { button, h, type IconName } from "../../page/dom";

export interface Choices {
  /** Ground and cameras of one stop; null for all stops' ground. */
  stop: string | null;
  shading: "photograph" | "lit" | "relief";
  /** Kind of the layer that is draped over the ground; empty: none. */
  drape: string;
  exaggeration: number;
  rover: boolean;
  cameras: boolean;
  traverse: boolean;
  ellipsoids: boolean;
  ties: boolean;
  views: boolean;
  ground: boolean;
  points: boolean;
  /** Size of a point, screen pixels. */
  pointSize: number;
  /** Speed along the traverse, metres per second. */
  walkSpeed: number;
  anaglyph: boolean;
}

export const FIRST: Choices = {
  stop: null,
  shading: "photograph",
  drape: "",
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
  walkSpeed: 2,
  anaglyph: false,
};

/** Switched separately for flying and for standing on the ground; off at first on the ground. */
const OUTLINES = ["cameras", "traverse", "ellipsoids"] as const;

export interface Actions {
  readonly changed: (choices: Readonly<Choices>, name: keyof Choices) => void;
  readonly lit: (sun: SunPlace) => void;
  readonly overview: () => void;
  readonly stand: () => void;
  readonly walk: () => void;
  readonly measure: () => void;
  readonly fullScreen: () => void;
}

export interface ControlPanel {
  /** A line below the view. */
  readonly element: HTMLElement;
  /** Panel that is opened over the view on demand. */
  readonly options: HTMLElement;
  readonly choices: Readonly<Choices>;
  /** The sun was moved elsewhere. */
  readonly putSun: (sun: SunPlace) => void;
  /** Called with the new viewpoint. */
  readonly setCameraMode: (at: "flying" | "standing" | "walking") => void;
  readonly putMeasuring: (isMeasuring: boolean) => void;
  /** Chooses stop and layer without notifying listeners. */
  readonly choose: (chosen: Pick<Choices, "stop" | "drape">) => void;
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
const SHADINGS = [
  ["photograph", "as photographed"],
  ["lit", "photograph, lit by the sun"],
  ["relief", "relief, lit by the sun"],
] as const;

type Named = readonly (readonly [value: string, title: string])[];

export function controls(
  stops: Named,
  /** Kinds of layers that may be draped over the ground. */
  layers: Named,
  sun: SunPlace,
  actions: Actions,
): ControlPanel {
  const choices = { ...FIRST };
  const set = <K extends keyof Choices>(name: K, value: Choices[K]) => {
    choices[name] = value;
    points.row.hidden = !choices.points;
    actions.changed(choices, name);
  };
  const stop = h(
    "select",
    { "aria-label": "stop", name: "stop", onchange: () => set("stop", stop.value || null) },
    h("option", { value: "" }, "all stops"),
    ...stops.map(([id, title]) => h("option", { value: id }, title)),
  );
  const shading = h(
    "select",
    {
      "aria-label": "shading of the ground",
      name: "shading",
      onchange: () => set("shading", shading.value as Choices["shading"]),
    },
    ...SHADINGS.map(([value, title]) => h("option", { value }, title)),
  );
  const drape = h(
    "select",
    {
      "aria-label": "layer over the ground",
      name: "drape",
      onchange: () => set("drape", drape.value),
    },
    h("option", { value: "" }, "no layer over it"),
    ...layers.map(([kind, title]) => h("option", { value: kind }, title)),
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
  const walking = slider("walkSpeed", "speed", [0.5, 10, 0.5], " m/s", 2, (speed) =>
    set("walkSpeed", speed),
  );
  points.row.hidden = true;
  let currentSun = sun;
  const moveSun = (part: Partial<SunPlace>) => actions.lit({ ...currentSun, ...part });
  const from = slider("azimuth", "azimuth", [0, 355, 5], "°", sun.azimuthDeg, (azimuthDeg) =>
    moveSun({ azimuthDeg }),
  );
  const above = slider(
    "elevation",
    "elevation",
    [1, 90, 1],
    "°",
    sun.elevationDeg,
    (elevationDeg) => moveSun({ elevationDeg }),
  );
  const putSun = (to: SunPlace) => {
    currentSun = to;
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
    return { name, input, label: h("label", {}, input, title) };
  });
  let isOnGround = false;
  let other: Partial<Choices> = { cameras: false, traverse: false, ellipsoids: false };
  const setCameraMode = (at: "flying" | "standing" | "walking") => {
    walk.setAttribute("aria-pressed", String(at === "walking"));
    name(walk, at === "walking" ? "stop walking" : "walk the traverse");
    if (isOnGround === (at !== "flying")) return;
    isOnGround = !isOnGround;
    const requested = other;
    other = Object.fromEntries(OUTLINES.map((name) => [name, choices[name]]));
    Object.assign(choices, requested);
    for (const { name, input } of toggles) input.checked = choices[name];
    actions.changed(choices, "cameras");
  };
  const putMeasuring = (isMeasuring: boolean) =>
    measure.setAttribute("aria-pressed", String(isMeasuring));
  const choose = (chosen: Pick<Choices, "stop" | "drape">) => {
    Object.assign(choices, chosen);
    stop.value = chosen.stop ?? "";
    drape.value = chosen.drape;
  };
  const act = (name: string, title: string, picture: IconName, run: () => void) =>
    button(title, picture, run, { class: "ghost", name });
  const name = (to: HTMLElement, title: string) => {
    to.title = title;
    to.setAttribute("aria-label", title);
  };
  const walk = act("walk", "walk the traverse", "way", actions.walk);
  walk.disabled = stops.length < 2;
  const measure = act("measure", "measure", "ruler", actions.measure);
  const open = act("options", "options of the 3D view", "options", () => toggle());
  const rows = (title: string, ...parts: HTMLElement[]) =>
    h("fieldset", {}, h("legend", {}, title), ...parts);
  const options = h(
    "form",
    { class: "scene-options", hidden: true, onsubmit: (event) => event.preventDefault() },
    rows("Show", h("div", { class: "switches" }, ...toggles.map(({ label }) => label)), points.row),
    rows("Ground", shading, heights.row),
    rows("Sun", from.row, above.row),
    rows("Walk", walking.row),
  );
  options.addEventListener("keydown", ({ key }) => {
    if (key !== "Escape") return;
    toggle();
    open.focus();
  });
  const toggle = () => {
    options.hidden = !options.hidden;
    open.setAttribute("aria-expanded", String(!options.hidden));
  };
  open.setAttribute("aria-expanded", "false");
  const element = h(
    "div",
    { class: "scene-controls", role: "toolbar", "aria-label": "3D view" },
    h("div", {}, stop, drape),
    h(
      "div",
      { class: "acts" },
      act("overview", "overview", "fit", actions.overview),
      act("stand", "stand at the stop", "eye", actions.stand),
      walk,
      measure,
      act("full", "full screen", "expand", actions.fullScreen),
      open,
    ),
  );
  return { element, options, choices, putSun, setCameraMode, putMeasuring, choose };
}
