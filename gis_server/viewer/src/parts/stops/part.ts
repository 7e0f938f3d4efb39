/** The tab of stops, and how large their error ellipses are drawn. */

import type Feature from "ol/Feature";
import type Geometry from "ol/geom/Geometry";
import { ellipseFactor } from "../../map/styles";
import type { MapPoint } from "../../server/records";
import type { Context } from "../../session/context";
import { type StopRow, stopPanel, stopRows } from "./panel";

/** Width of the ground shown around a stop that was asked for, metres. */
const STOP_VIEW_M = 24;

export function stopsPart(context: Context): void {
  const { page, view, layers, waiting } = context;
  const panel = page.addTab("stops", "Stops");
  const zoomTo = ([east, north]: MapPoint) => {
    const half = STOP_VIEW_M / 2;
    view.fit([east - half, north - half, east + half, north + half]);
  };
  const load = async () => {
    const features = await view.featuresOf(layers.widest("stops"));
    const rows = stopRows(features);
    panel.replaceChildren(stopPanel(rows, zoomTo));
    sizeEllipses(context, features, rows);
  };
  layers.replaced.on(() => waiting.run(load));
  waiting.run(load);
}

function sizeEllipses(
  { drawing, signals, view }: Context,
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
  signals.ellipses.emit(drawing.ellipseFactor);
  view.redraw();
}
