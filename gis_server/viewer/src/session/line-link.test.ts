import { expect, test } from "vitest";
import type { Chart } from "../page/chart";
import type { MapPoint } from "../server/records";
import type { Context, Pointed } from "./context";
import { LineLink } from "./line-link";
import { Signal } from "./signal";

const LINE: readonly MapPoint[] = [
  [0, 0],
  [10, 0],
];

function marked() {
  const marks: (number | null)[] = [];
  return { marks, chart: { mark: (x: number | null) => marks.push(x) } as unknown as Chart };
}

function linked() {
  const events = { pointer: new Signal<Pointed | null>(), cursor: new Signal<MapPoint | null>() };
  const context = { events, view: { resolution: 0.1 } } as unknown as Context;
  const { marks, chart } = marked();
  const link = new LineLink(context);
  link.on(LINE, chart);
  return { events, link, marks };
}
const at = (point: MapPoint): Pointed => ({ point, pixel: [0, 0], touched: null });

test("the pointer near the line marks the chart, further off it does not", () => {
  const { events, marks } = linked();
  events.pointer.emit(at([7, 3.9]));
  events.pointer.emit(at([7, 4.1]));
  expect(marks).toEqual([null, 7, null]);
});

test("a chart that replaces another keeps the place that is pointed at", () => {
  const { events, link } = linked();
  events.pointer.emit(at([7, 1]));
  const { marks, chart } = marked();
  link.on(LINE, chart);
  expect(marks).toEqual([7]);
});

test("the chart's cursor is a place on the map", () => {
  const { events, link } = linked();
  const places: (MapPoint | null)[] = [];
  events.cursor.on((place) => places.push(place));
  link.setCursor(2.5);
  link.off();
  expect(places).toEqual([[2.5, 0], null]);
});
