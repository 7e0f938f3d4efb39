/** The drawn parts of a chart: axes, bands, lines, dots and the marks of its cursor. */

import {
  bandPath,
  type Interval,
  isNumber,
  linear,
  linePath,
  type Scale,
  tickDecimals,
  tickStep,
  ticks,
  valueAt,
} from "./chart-scale";
import { type ChartOptions, edge, type Series } from "./chart-series";
import { h } from "./dom";
import { fixed } from "./format";
import { svg } from "./svg";

const MARGIN = { left: 56, right: 14, top: 22, bottom: 34 } as const;
const PX_A_TICK = { x: 90, y: 34 } as const;
export interface Scales {
  readonly x: Scale;
  readonly y: Scale;
}

export function scalesOf(
  { x, y }: { x: Interval; y: Interval },
  width: number,
  height: number,
): Scales {
  const { left, right, top, bottom } = MARGIN;
  return {
    x: linear(x, [left, Math.max(left + 1, width - right)]),
    y: linear(y, [Math.max(top + 1, height - bottom), top]),
  };
}

export function legend(series: readonly Series[]): HTMLElement {
  const entry = ({ name, colour, isDashed }: Series) =>
    h(
      "span",
      {},
      h("i", { style: `border-top:2px ${isDashed ? "dashed" : "solid"} ${colour}` }),
      name,
    );
  return h("div", { class: "chart-legend" }, ...series.map(entry));
}

export function axes(
  { x: xAxis, y: yAxis }: ChartOptions,
  { x, y }: Scales,
  height: number,
): SVGElement[] {
  const [left, right] = [x(x.domain[0]), x(x.domain[1])];
  const [bottom, top] = [y(y.domain[0]), y(y.domain[1])];
  const counts = [(right - left) / PX_A_TICK.x, (bottom - top) / PX_A_TICK.y] as const;
  const marks: SVGElement[] = [];
  const [xDecimals, yDecimals] = [
    tickDecimals(tickStep(x.domain, counts[0])),
    tickDecimals(tickStep(y.domain, counts[1])),
  ];
  for (const value of ticks(y.domain, counts[1])) {
    marks.push(svg("path", { class: "chart-grid", d: `M${left},${y(value)}H${right}` }));
    const text = { class: "chart-tick", x: left - 6, y: y(value) + 4, "text-anchor": "end" };
    marks.push(svg("text", text, fixed(value, yDecimals)));
  }
  for (const value of ticks(x.domain, counts[0])) {
    marks.push(svg("path", { class: "chart-grid", d: `M${x(value)},${bottom}v4` }));
    const text = { class: "chart-tick", x: x(value), y: bottom + 15, "text-anchor": "middle" };
    marks.push(svg("text", text, fixed(value, xDecimals)));
  }
  marks.push(svg("path", { class: "chart-axis", d: `M${left},${top}V${bottom}H${right}` }));
  const name = { class: "chart-tick", x: right, y: height - 5, "text-anchor": "end" };
  marks.push(svg("text", name, `${xAxis.title}, ${xAxis.unit}`));
  marks.push(svg("text", { class: "chart-tick", x: 4, y: 12 }, `${yAxis.title}, ${yAxis.unit}`));
  return marks;
}

export function lines(series: readonly Series[], { x, y }: Scales): SVGElement[] {
  const bands = series
    .filter(({ sigma }) => sigma)
    .map((one) => bandPath(one.xs, edge(one, -1), edge(one, 1), x, y))
    .map((d, k) =>
      svg("path", { class: "chart-band", d, fill: series.filter((s) => s.sigma)[k]?.colour }),
    );
  const paths = series.flatMap((one) => [
    svg("path", {
      class: "chart-line",
      "data-series": one.name,
      d: linePath(one.xs, one.ys, x, y),
      stroke: one.colour,
      "stroke-dasharray": one.isDashed ? "6 4" : null,
    }),
    ...(one.hasDots ? dots(one, x, y) : []),
  ]);
  return [...bands, ...paths];
}

function dots({ xs, ys, colour }: Series, x: Scale, y: Scale): SVGElement[] {
  return xs.flatMap((at, k) => {
    const value = ys[k];
    if (!isNumber(at) || !isNumber(value)) return [];
    return [svg("circle", { cx: x(at), cy: y(value), r: 3, fill: colour })];
  });
}

export function cursorMarks(series: readonly Series[], { x, y }: Scales, at: number): SVGElement[] {
  const line = svg("path", { d: `M${x(at)},${y(y.domain[1])}V${y(y.domain[0])}` });
  const marks = series.flatMap(({ xs, ys, colour }) => {
    const value = valueAt(xs, ys, at);
    if (value === null) return [];
    return [svg("circle", { cx: x(at), cy: y(value), r: 4.5, fill: "none", stroke: colour })];
  });
  return [line, ...marks];
}
