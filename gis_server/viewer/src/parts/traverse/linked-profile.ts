/** The profile in the dock below the map, its cursor tied to that of the map both ways. */

import type { Chart } from "../../page/chart";
import { h } from "../../page/dom";
import { measuring, type Profile } from "../../server/measure";
import type { TraverseAnswer } from "../../server/network";
import { ApiError } from "../../server/api";
import type { MapPoint } from "../../server/records";
import type { Context } from "../../session/context";
import { nearestOn, placeAt } from "./along";
import { profileChart } from "./profile";

/** The pointer is at the traverse when it is no further from it on the screen. */
const REACH_PX = 40;

export class LinkedProfile {
  private chart: Chart | null = null;
  private line: readonly MapPoint[] = [];
  private readonly body = h("div", { class: "linked-profile" });

  constructor(private readonly context: Context) {
    const { signals } = context;
    signals.pointer.on((pointed) => this.markNear(pointed?.point ?? null));
    signals.cursor.on((point) => this.markNear(point));
  }

  get isOpen(): boolean {
    return this.chart !== null;
  }

  open(answer: TraverseAnswer): void {
    const { page, waiting } = this.context;
    this.line = answer.rows.map(({ place }): MapPoint => [place[0], place[1]]);
    if (!this.isOpen)
      page.below.open("Vertical profile of the traverse", this.body, () => this.closed());
    this.draw(answer, null);
    waiting.run(async () => {
      const ground = await this.ground();
      if (ground && this.isOpen) this.draw(answer, ground);
    });
  }

  private draw(answer: TraverseAnswer, ground: Profile | null): void {
    this.chart = profileChart(answer, ground, (distance) => this.tell(distance));
    this.body.replaceChildren(this.chart.element);
  }

  /** The ground below the traverse; null where none of it was mapped. */
  private async ground(): Promise<Profile | null> {
    const { mission, alive } = this.context;
    try {
      return await measuring.profile(mission.mission, this.line, alive);
    } catch (reason) {
      if (reason instanceof ApiError && reason.status === 422) return null;
      throw reason;
    }
  }

  private closed(): void {
    this.chart = null;
    this.context.signals.cursor.emit(null);
  }

  private tell(distance_m: number | null): void {
    const place = distance_m === null ? null : placeAt(this.line, distance_m);
    this.context.signals.cursor.emit(place);
  }

  private markNear(point: MapPoint | null): void {
    if (!this.chart) return;
    const near = point && nearestOn(this.line, point);
    const reach = REACH_PX * this.context.view.resolution;
    this.chart.mark(near && near.off_m <= reach ? near.distance_m : null);
  }
}
