/**
 * Line charts: axes, bands of uncertainty, gaps, and a cursor that pointer, keys and other parts of the page move.
 *
 * To assistive technology a chart is a slider along its x axis: the arrow keys step from value to value, and each value
 * is given in words. A summary follows the chart as text.
 */

import "./chart.css";
import { axes, cursorMarks, legend, lines, scalesOf } from "./chart-drawing";
import { type ChartOptions, domains, keyed, valuesText } from "./chart-series";
import { h } from "./dom";
import { fixed } from "./format";
import { svg } from "./svg";

export type { Axis, ChartOptions, Series } from "./chart-series";

export interface Chart {
  readonly element: HTMLElement;
  /** Puts the cursor at a position on the x axis without notifying listeners. */
  mark(x: number | null): void;
}

export function chart(options: ChartOptions): Chart {
  const { x: axis, title, series } = options;
  const domain = domains(series);
  const cursor = svg("g", { class: "chart-cursor", visibility: "hidden" });
  const drawing = svg("svg", { "aria-hidden": "true" });
  const field = h("div", {
    class: "chart-field",
    tabindex: 0,
    role: "slider",
    "aria-label": `${title}: ${axis.title}`,
    "aria-valuemin": domain.x[0].toFixed(axis.decimals),
    "aria-valuemax": domain.x[1].toFixed(axis.decimals),
    "aria-valuenow": domain.x[0].toFixed(axis.decimals),
  });
  const readout = h("output", { class: "chart-readout" });
  field.append(drawing);
  const element = h(
    "figure",
    { class: "chart" },
    h("div", { class: "chart-head" }, legend(series), readout),
    field,
    h("figcaption", {}, options.summary),
  );
  let scales = scalesOf(domain, 640, 180);
  let current: number | null = null;

  const mark = (at: number | null) => {
    current = at;
    cursor.setAttribute("visibility", at === null ? "hidden" : "visible");
    readout.textContent =
      at === null ? "" : `${fixed(at, axis.decimals)} ${axis.unit}: ${valuesText(options, at)}`;
    if (at === null) return;
    field.setAttribute("aria-valuenow", at.toFixed(axis.decimals));
    field.setAttribute("aria-valuetext", readout.textContent);
    cursor.replaceChildren(...cursorMarks(series, scales, at));
  };
  const move = (at: number | null) => {
    const inside = at === null ? null : Math.min(domain.x[1], Math.max(domain.x[0], at));
    mark(inside);
    options.onCursor?.(inside);
  };
  const draw = () => {
    const { clientWidth, clientHeight } = field;
    if (clientWidth === 0 || clientHeight === 0) return;
    scales = scalesOf(domain, clientWidth, clientHeight);
    drawing.setAttribute("viewBox", `0 0 ${clientWidth} ${clientHeight}`);
    drawing.replaceChildren(
      ...axes(options, scales, clientHeight),
      ...lines(series, scales),
      cursor,
    );
    mark(current);
  };
  field.addEventListener("pointermove", ({ clientX }) =>
    move(scales.x.invert(clientX - field.getBoundingClientRect().left)),
  );
  field.addEventListener("pointerleave", () => move(null));
  field.addEventListener("keydown", (event) => {
    const next = keyed(event.key, current, domain.x);
    if (next === undefined) return;
    event.preventDefault();
    event.stopPropagation();
    move(next);
  });
  new ResizeObserver(draw).observe(field);
  return { element, mark };
}
