/** The tab of the traverse: differences of telemetry, vertical profile, and stops. */

import type Feature from "ol/Feature";
import type Geometry from "ol/geom/Geometry";
import "./traverse.css";
import { ellipseFactor } from "../../map/styles";
import { h } from "../../page/dom";
import type { MapPoint } from "../../server/records";
import type { Context } from "../../session/context";
import { Comparison } from "./comparison";
import { type StopRow, stopPanel, stopRows } from "./stop-table";

/** Width of the ground shown around a chosen stop, metres. */
const STOP_VIEW_M = 24;

export function traversePart(context: Context): void {
  const { page, view, layers, waiting } = context;
  const panel = page.addTab("stops");
  const zoomTo = ([east, north]: MapPoint) => {
    const half = STOP_VIEW_M / 2;
    view.fit([east - half, north - half, east + half, north + half]);
  };
  const stops = h("div");
  const comparison = new Comparison(context, zoomTo);
  panel.replaceChildren(comparison.element, h("h2", {}, "Stops"), stops);
  const load = async () => {
    const features = await view.featuresOf(layers.widest("stops"));
    const rows = stopRows(features);
    stops.replaceChildren(stopPanel(rows, zoomTo));
    sizeEllipses(context, features, rows);
  };
  const loadAll = () => {
    waiting.run(load);
    waiting.run(() => comparison.load());
  };
  layers.replaced.on(loadAll);
  loadAll();
}

function sizeEllipses(
  { drawing, events, view }: Context,
  features: readonly Feature<Geometry>[],
  rows: readonly StopRow[],
): void {
  const majors = features.map((feature) => Number(feature.get("ellipse_semi_major_m") ?? 0));
  const norths = rows.map(({ at }) => at[1]);
  const easts = rows.map(({ at }) => at[0]);
  const extent = Math.hypot(
    Math.max(...norths) - Math.min(...norths),
    Math.max(...easts) - Math.min(...easts),
  );
  drawing.ellipseFactor = ellipseFactor(Math.max(0, ...majors), Math.max(extent, STOP_VIEW_M));
  events.ellipses.emit(drawing.ellipseFactor);
  view.redraw();
}
