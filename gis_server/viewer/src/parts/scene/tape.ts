/** Measuring from one place of the ground to another. */

import { h } from "../../page/dom";
import type { MapPoint } from "../../server/records";
import type { Place3 } from "../../server/scene";
import { discard, dots, segments } from "./drawings";
import type { Stage } from "./stage";

const COLOUR = "#ffd400";
const UNDER = "#000000";

export class Tape {
  isOn = false;
  private first: Place3 | null = null;
  private drawn: ReturnType<typeof dots | typeof segments>[] = [];

  constructor(
    private readonly stage: Stage,
    private readonly card: HTMLElement,
    /** Two places are to be measured; the box receives the result. */
    private readonly measure: (corners: readonly MapPoint[], box: HTMLElement) => void,
  ) {}

  /** Begins, or ends and takes away what was drawn. */
  toggle(): void {
    this.isOn = !this.isOn;
    this.first = null;
    this.draw([]);
    this.show(h("p", {}, "Click two places of the ground."));
    this.card.hidden = !this.isOn;
  }

  at(place: Place3): void {
    const { first } = this;
    if (!first) {
      this.first = place;
      this.draw([place]);
      this.show(h("p", {}, "Click the other place."));
      return;
    }
    this.first = null;
    this.draw([first, place]);
    const box = h("div", { role: "status" }, "Loading…");
    this.show(box);
    this.measure(
      [first, place].map(([east, north]) => [east, north] as const),
      box,
    );
  }

  private show(what: HTMLElement): void {
    this.card.classList.remove("at-left");
    this.card.replaceChildren(what);
    this.card.hidden = false;
  }

  private draw(places: readonly Place3[]): void {
    for (const old of this.drawn) discard(old);
    const { origin, world } = this.stage;
    const line = (color: string, width: number) =>
      segments(places, origin, { color, width, above: true });
    this.drawn = places.length > 1 ? [line(UNDER, 5), line(COLOUR, 3)] : [];
    if (places.length > 0) {
      const ends = dots(places, origin, COLOUR, 8);
      ends.material = Object.assign(ends.material, { depthTest: false });
      ends.renderOrder = 6;
      this.drawn.push(ends);
    }
    if (this.drawn.length > 0) world.add(...this.drawn);
    this.stage.requestFrame();
  }
}
