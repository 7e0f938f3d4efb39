/** The meaning of colours: a strip of them with values, or a swatch for each class. */

import type { Legend } from "../server/records";
import { h } from "./dom";
import { fixed, unitSign } from "./format";

export const swatch = (style: string, text: string) =>
  h("div", { class: "swatch" }, h("i", { style }), text);
export const legend = (...rows: HTMLElement[]) => h("div", { class: "legend" }, ...rows);

const MOST_DECIMALS = 6;

/** Values with the same number of decimals, the fewest that change none by more than 1/400 of their span. */
function tickTexts(values: readonly number[]): string[] {
  const most = Math.abs((values.at(-1) ?? 0) - (values[0] ?? 0)) / 400;
  let decimals = 0;
  const isOff = (value: number) => Math.abs(Number(value.toFixed(decimals)) - value) > most;
  while (decimals < MOST_DECIMALS && values.some(isOff)) decimals += 1;
  return values.map((value) => fixed(value, decimals));
}

/** Colours with their values, or classes with their names; null where there is no legend. */
export function colourLegend({ stops, unit, classes, note }: Legend): HTMLElement | null {
  const notes = note ? [h("div", { class: "unit note" }, note)] : [];
  if (classes?.length)
    return legend(
      ...classes.map(({ name, colour }) =>
        swatch(`background:${colour};width:14px;height:14px`, name),
      ),
      ...notes,
    );
  const first = stops[0];
  const last = stops.at(-1);
  if (!first || !last || first === last) return null;
  const span = last[0] - first[0] || 1;
  const parts = stops.map(([value, colour]) => {
    const share = (100 * (value - first[0])) / span;
    return `${colour} ${share.toFixed(1)}%`;
  });
  const ticks = tickTexts([0, 0.25, 0.5, 0.75, 1].map((share) => first[0] + share * span));
  ticks.push(`${ticks.pop()}${unitSign(unit)}`);
  return h(
    "div",
    { class: "legend" },
    h("div", { class: "ramp", style: `background:linear-gradient(90deg, ${parts.join(", ")})` }),
    h("div", { class: "ticks" }, ...ticks.map((tick) => h("span", {}, tick))),
    ...notes,
  );
}
