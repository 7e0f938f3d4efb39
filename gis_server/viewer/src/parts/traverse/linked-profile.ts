/** The profile below the map, its cursor tied to that of the map both ways. */

import { h } from "../../page/dom";
import { measuring, type Profile } from "../../server/measure";
import type { TraverseAnswer } from "../../server/network";
import { ApiError } from "../../server/api";
import type { MapPoint } from "../../server/records";
import type { Context } from "../../session/context";
import { LineLink } from "../../session/line-link";
import { profileChart } from "./profile";

export class LinkedProfile {
  readonly element = h("div", { class: "linked-profile" });
  private readonly link: LineLink;
  private line: readonly MapPoint[] = [];
  private isOpen = true;

  constructor(private readonly context: Context) {
    this.link = new LineLink(context);
  }

  draw(answer: TraverseAnswer): void {
    this.line = answer.rows.map(({ place }): MapPoint => [place[0], place[1]]);
    this.chart(answer, null);
    this.context.waiting.run(async () => {
      const ground = await this.ground();
      if (ground && this.isOpen) this.chart(answer, ground);
    });
  }

  dispose(): void {
    this.isOpen = false;
    this.link.off();
  }

  private chart(answer: TraverseAnswer, ground: Profile | null): void {
    const drawn = profileChart(answer, ground, this.link.setCursor);
    this.link.on(this.line, drawn);
    this.element.replaceChildren(drawn.element);
  }

  /** The ground below the traverse; null where none of it was mapped. */
  private async ground(): Promise<Profile | null> {
    const { mission, signal } = this.context;
    try {
      return await measuring.profile(mission.mission, this.line, signal);
    } catch (reason) {
      if (reason instanceof ApiError && reason.status === 422) return null;
      throw reason;
    }
  }
}
