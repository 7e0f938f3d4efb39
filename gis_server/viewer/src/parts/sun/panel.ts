/** The tab of the sun: its time, its position, and its layers on the map. */

import { legendOfColours, colouringOf } from "../../map/raster-style";
import type { SunPlace } from "../../map/shading";
import { facts, h } from "../../page/dom";
import { fixed } from "../../page/format";
import { colourLegend } from "../../page/legend";
import type { RasterLayer } from "../../server/records";
import type { Light, Sky } from "../../session/state";
import { clock } from "./light";
import { stylesOf } from "./overlays";
import type { Daylight } from "./sun-place";

export interface SunActions {
  readonly setSky: (sky: Sky) => void;
  readonly setLight: (light: Light) => void;
  readonly setGround: (id: string) => void;
}

export interface SunPanel {
  readonly element: HTMLElement;
  /** Sets all controls from the state of the sun and its layers. */
  readonly follow: (state: SunState) => void;
}

export interface SunState {
  readonly sky: Sky;
  readonly sun: SunPlace;
  /** Daylight; null if the sun was set manually, or no image relates sols to Mars time. */
  readonly day: Daylight | null;
  readonly light: Light;
}

function slider(
  name: string,
  min: number,
  max: number,
  step: number,
  set: (value: number) => void,
) {
  const input = h("input", {
    type: "range",
    min,
    max,
    step,
    "aria-label": name,
    oninput: () => set(Number(input.value)),
  });
  return input;
}

function box(name: string, set: (on: boolean) => void) {
  const input = h("input", { type: "checkbox", onchange: () => set(input.checked) });
  return { input, element: h("label", { class: "inline check" }, input, name) };
}

function threshold(name: string, first: number, set: (degrees: number | null) => void) {
  const angle = h("input", {
    type: "number",
    class: "compact-number",
    min: -45,
    max: 60,
    step: 0.5,
    value: first,
    "aria-label": `least ${name}, degrees`,
    onchange: () => update(),
  });
  const update = () => set(on.input.checked ? Number(angle.value) : null);
  const on = box(`${name} from`, update);
  const legend = h("div");
  const put = (degrees: number | null) => {
    on.input.checked = degrees !== null;
    if (degrees !== null) angle.value = String(degrees);
  };
  return {
    put,
    legend,
    element: h("div", {}, h("div", { class: "inline" }, on.element, angle, "°"), legend),
  };
}

/** `firstSol` null: sols are not known, and only the sky can be chosen. */
export function sunPanel(
  grounds: readonly (readonly [id: string, title: string])[],
  chosen: RasterLayer,
  firstSol: number | null,
  actions: SunActions,
): SunPanel {
  let state: SunState | null = null;
  const light = (part: Partial<Light>) => state && actions.setLight({ ...state.light, ...part });
  const place = (part: Partial<SunPlace>) =>
    state && actions.setSky({ by: "hand", sun: { ...state.sun, ...part } });
  const time = (part: { sol?: number; hours?: number }) => {
    const now = state?.sky.by === "time" ? state.sky : { sol: firstSol ?? 0, hours: 12 };
    actions.setSky({ ...now, by: "time", ...part });
  };
  const sol = h("input", {
    type: "number",
    class: "compact-number",
    min: 0,
    step: 1,
    value: firstSol ?? 0,
    "aria-label": "sol of the sun",
    onchange: () => time({ sol: Math.max(0, Math.round(Number(sol.value))) }),
  });
  const hours = slider("local true solar time", 0, 24, 1 / 12, (value) => time({ hours: value }));
  hours.value = "12";
  const azimuth = slider("azimuth of the sun", 0, 360, 1, (azimuthDeg) => place({ azimuthDeg }));
  const elevation = slider("elevation of the sun", 0, 90, 0.5, (elevationDeg) =>
    place({ elevationDeg }),
  );
  const [hoursText, azimuthText, elevationText, details] = [
    h("output"),
    h("output"),
    h("output"),
    h("div"),
  ];
  const relief = box("relief under this sun", (on) => light({ relief: on }));
  const strength = slider("strength of the relief", 0, 1, 0.05, (value) =>
    light({ strength: value }),
  );
  const shadow = box("shadows cast by the ground", (on) => light({ shadow: on }));
  const tilt = threshold("ground that tilts north", 5, (tiltDeg) => light({ tiltDeg }));
  const slope = threshold("ground that is steep", 15, (slopeDeg) => light({ slopeDeg }));
  const ground = h(
    "select",
    { "aria-label": "ground", onchange: () => actions.setGround(ground.value) },
    ...grounds.map(([id, title]) => h("option", { value: id, selected: id === chosen.id }, title)),
  );
  const legendIn = (where: HTMLElement, name: string, now: Light) => {
    const style = stylesOf(now).get(name);
    const legend = style && colourLegend(legendOfColours(colouringOf(chosen, style)));
    where.replaceChildren(...(legend ? [legend] : []));
  };
  const element = h(
    "div",
    { class: "sun" },
    h("label", { class: "inline" }, h("span", {}, "ground"), ground),
    firstSol === null
      ? h("p", { class: "hint" }, "No image relates the sols of this mission to Mars time.")
      : h(
          "div",
          { class: "times" },
          h("label", { class: "inline" }, h("span", {}, "sol"), sol),
          h("label", { class: "inline" }, h("span", {}, "solar time"), hours, hoursText),
        ),
    h("label", { class: "inline" }, h("span", {}, "azimuth"), azimuth, azimuthText),
    h("label", { class: "inline" }, h("span", {}, "elevation"), elevation, elevationText),
    details,
    h("h2", {}, "Shading of the map"),
    h("div", { class: "inline" }, relief.element, strength),
    shadow.element,
    tilt.element,
    slope.element,
    h(
      "p",
      { class: "hint" },
      "Angles are of the plane through nine cells, so they depend on the zoom; the layers of slope and tilt are computed over a rover's wheel base.",
    ),
  );
  const follow = (now: SunState) => {
    state = now;
    const { azimuthDeg, elevationDeg } = now.sun;
    if (now.sky.by === "time")
      [sol.value, hours.value] = [String(now.sky.sol), String(now.sky.hours)];
    hoursText.textContent = now.sky.by === "time" ? clock(now.sky.hours) : "–";
    [azimuth.value, elevation.value] = [String(azimuthDeg), String(Math.max(0, elevationDeg))];
    azimuthText.textContent = `${fixed(azimuthDeg, 1)}°`;
    elevationText.textContent = `${fixed(elevationDeg, 1)}°`;
    details.replaceChildren(
      facts([
        ["Ls", now.day ? `${fixed(now.day.lsDeg, 1)}°` : null],
        ["UTC", now.day ? now.day.moment.toISOString().slice(0, 16).replace("T", " ") : null],
        ["sun", now.sun.elevationDeg <= 0 ? "below the horizon" : null],
      ]),
    );
    relief.input.checked = now.light.relief;
    strength.value = String(now.light.strength);
    strength.hidden = !now.light.relief;
    shadow.input.checked = now.light.shadow;
    tilt.put(now.light.tiltDeg);
    slope.put(now.light.slopeDeg);
    legendIn(tilt.legend, "tilt", now.light);
    legendIn(slope.legend, "slope", now.light);
  };
  return { element, follow };
}
