/** Pointer and keys on the 3D view. */

import type { Place3 } from "../../server/scene";
import { pressed } from "./keyboard";
import type { Sights } from "./sights";
import type { Stage } from "./stage";
import type { Terrain } from "./terrain";

/** Half of the view. */
export type Side = "left" | "right";

export interface Hand {
  /** The pointer is over a place of the ground; null: over none. */
  readonly over: (place: Place3 | null) => void;
  /** The camera of an image was clicked. */
  readonly image: (id: string, side: Side) => void;
  /** Goes back to flying; false if it was not left. */
  readonly leave: () => boolean;
  readonly isStanding: () => boolean;
}

const NAME =
  "3D view: arrow keys turn it, with Shift they move it, plus and minus come nearer and go away";

export function takeInHand(
  stage: Stage,
  terrain: Terrain,
  sights: Sights,
  hand: Hand,
  signal: AbortSignal,
): void {
  const canvas = stage.renderer.domElement;
  canvas.tabIndex = 0;
  canvas.setAttribute("role", "application");
  canvas.setAttribute("aria-label", NAME);
  const ground = ({ offsetX, offsetY }: MouseEvent) => {
    const hit = terrain.hit(stage.aim(offsetX, offsetY));
    return hit ? stage.place(hit.point) : null;
  };
  const point = (event: PointerEvent) => {
    if (!event.buttons) hand.over(ground(event));
  };
  const click = ({ offsetX, offsetY }: MouseEvent) => {
    const image = sights.at(offsetX, offsetY);
    if (image) hand.image(image, offsetX < canvas.clientWidth / 2 ? "left" : "right");
  };
  /** Turns about the place that was double-clicked from now on. */
  const turnTo = (event: MouseEvent) => {
    const place = ground(event);
    if (!place || hand.isStanding()) return;
    stage.controls.target.copy(stage.drawn(place));
    stage.controls.update();
    stage.ask();
  };
  const key = (event: KeyboardEvent) => {
    if (event.ctrlKey || event.altKey || event.metaKey) return;
    const isKnown = (event.key === "Escape" && hand.leave()) || pressed(stage, event);
    if (!isKnown) return;
    event.preventDefault();
    event.stopPropagation();
  };
  canvas.addEventListener("pointermove", point, { signal });
  canvas.addEventListener("pointerleave", () => hand.over(null), { signal });
  canvas.addEventListener("click", click, { signal });
  canvas.addEventListener("dblclick", turnTo, { signal });
  canvas.addEventListener("keydown", key, { signal });
}
