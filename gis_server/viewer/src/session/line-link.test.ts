import { expect, test } from "vitest";
import type { Chart } from "../page/chart";
import type { MapPoint } from "../server/records";
import type { Context, Pointed } from "./context";
import { LineLink } from "./line-link";
import { Signal } from "./signal";

function linked() {
  const signals = { pointer: new Signal<Pointed | null>(), cursor: new Signal<MapPoint | null>() };
  const context = { signals, view: { resolution: 0.1 } } as unknown as Context;
  const marks: (number | null)[] = [];
  const chart = { mark: (x: number | null) => marks.push(x) } as unknown as Chart;
  const link = new LineLink(context);
  link.on(
    [
      [0, 0],
      [10, 0],
    ],
    chart,
  );
  return { signals, link, marks };
}
const at = (point: MapPoint): Pointed => ({ point, pixel: [0, 0], touched: null });

test("the pointer near the line marks the chart, further off it does not", () => {
  const { signals, marks } = linked();
  signals.pointer.emit(at([7, 3.9]));
  signals.pointer.emit(at([7, 4.1]));
  expect(marks).toEqual([7, null]);
});

test("the chart's cursor is a place on the map", () => {
  const { signals, link } = linked();
  const places: (MapPoint | null)[] = [];
  signals.cursor.on((place) => places.push(place));
  link.tell(2.5);
  link.off();
  expect(places).toEqual([[2.5, 0], null]);
});
