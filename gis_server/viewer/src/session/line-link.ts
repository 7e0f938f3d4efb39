/** Ties a chart along a line to the cursor that all parts share: pointing at one shows the place in the other. */

import { nearestOn, placeAt } from "../map/along";
import type { Chart } from "../page/chart";
import type { MapPoint } from "../server/records";
import type { Context } from "./context";

/** The pointer is at the line when it is no further from it on the screen. */
const REACH_PX = 40;

export class LineLink {
  private chart: Chart | null = null;
  private line: readonly MapPoint[] = [];
  private pointed: MapPoint | null = null;
  private readonly unsubscribe: readonly (() => void)[];

  constructor(private readonly context: Pick<Context, "events" | "view">) {
    this.unsubscribe = [
      context.events.pointer.on((pointed) => this.markNear(pointed?.point ?? null)),
      context.events.cursor.on((point) => this.markNear(point)),
    ];
  }

  /** A chart that replaces another shows the place that is pointed at as that one did. */
  on(line: readonly MapPoint[], chart: Chart): void {
    this.line = line;
    this.chart = chart;
    this.markNear(this.pointed);
  }

  off(): void {
    for (const end of this.unsubscribe) end();
    this.context.events.cursor.emit(null);
  }

  /** The chart's cursor is at a distance along the line; null: it left. */
  readonly setCursor = (distance_m: number | null): void => {
    const place = distance_m === null ? null : placeAt(this.line, distance_m);
    this.context.events.cursor.emit(place);
  };

  private markNear(point: MapPoint | null): void {
    this.pointed = point;
    if (!this.chart) return;
    const near = point && nearestOn(this.line, point);
    const reach = REACH_PX * this.context.view.resolution;
    this.chart.mark(near && near.off_m <= reach ? near.distance_m : null);
  }
}
