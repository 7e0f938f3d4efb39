/** The profile in the dock below the map, its cursor tied to that of the map both ways. */

import { h } from "../../page/dom";
import { measuring, type Profile } from "../../server/measure";
import type { TraverseAnswer } from "../../server/network";
import { ApiError } from "../../server/api";
import type { MapPoint } from "../../server/records";
import type { Context } from "../../session/context";
import { LineLink } from "../../session/line-link";
import { profileChart } from "./profile";

export class LinkedProfile {
  private readonly link: LineLink;
  private line: readonly MapPoint[] = [];
  private readonly body = h("div", { class: "linked-profile" });

  constructor(private readonly context: Context) {
    this.link = new LineLink(context);
  }

  get isOpen(): boolean {
    return this.link.isOn;
  }

  open(answer: TraverseAnswer): void {
    const { page, waiting } = this.context;
    this.line = answer.rows.map(({ place }): MapPoint => [place[0], place[1]]);
    if (!this.isOpen)
      page.below.open("Vertical profile of the traverse", this.body, () => this.link.off());
    this.draw(answer, null);
    waiting.run(async () => {
      const ground = await this.ground();
      if (ground && this.isOpen) this.draw(answer, ground);
    });
  }

  private draw(answer: TraverseAnswer, ground: Profile | null): void {
    const drawn = profileChart(answer, ground, this.link.tell);
    this.link.on(this.line, drawn);
    this.body.replaceChildren(drawn.element);
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
}
