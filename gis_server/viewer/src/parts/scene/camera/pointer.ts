/** Pointer and keys on the 3D view. */

import type { Place3 } from "../../../server/scene";
import { pressed } from "./keyboard";
import type { Sights } from "../sights";
import type { Stage } from "../stage";
import type { Terrain } from "../surface/terrain";

/** Half of the view. */
export type Side = "left" | "right";

export interface PointerHandlers {
  /** The pointer is over a place of the ground; null: over none. */
  readonly over: (place: Place3 | null) => void;
  /** The camera of an image was clicked. */
  readonly image: (id: string, side: Side) => void;
  /** A place of the ground was clicked. */
  readonly ground: (place: Place3) => void;
  /** Ends measuring, or goes back to flying; false if there is nothing to end. */
  readonly leave: () => boolean;
  readonly isOnGround: () => boolean;
  readonly isMeasuring: () => boolean;
}

const NAME =
  "3D view: arrow keys turn it, with Shift they move it, plus and minus come nearer and go away, Enter clicks in the middle";
/** Largest movement of the pointer in a click, pixels. */
const STILL_PX = 4;

export function addPointerControls(
  stage: Stage,
  terrain: Terrain,
  sights: Sights,
  handlers: PointerHandlers,
  signal: AbortSignal,
): void {
  const canvas = stage.renderer.domElement;
  canvas.tabIndex = 0;
  canvas.setAttribute("role", "application");
  canvas.setAttribute("aria-label", NAME);
  const ground = ({ offsetX, offsetY }: Pick<MouseEvent, "offsetX" | "offsetY">) => {
    const hit = terrain.hit(stage.aim(offsetX, offsetY));
    return hit ? stage.place(hit.point) : null;
  };
  const point = (event: PointerEvent) => {
    if (!event.buttons) handlers.over(ground(event));
  };
  let pressedAt: readonly [number, number] = [0, 0];
  const press = ({ offsetX, offsetY }: PointerEvent) => {
    pressedAt = [offsetX, offsetY];
  };
  const act = (at: Pick<MouseEvent, "offsetX" | "offsetY">) => {
    const image = handlers.isMeasuring() ? null : sights.at(at.offsetX, at.offsetY);
    if (image) {
      handlers.image(image, at.offsetX < canvas.clientWidth / 2 ? "left" : "right");
      return;
    }
    const place = ground(at);
    if (place) handlers.ground(place);
  };
  const click = (event: MouseEvent) => {
    const moved = Math.hypot(event.offsetX - pressedAt[0], event.offsetY - pressedAt[1]);
    if (moved <= STILL_PX && event.detail < 2) act(event);
  };
  /** Turns about the place that was double-clicked from now on. */
  const turnTo = (event: MouseEvent) => {
    const place = ground(event);
    if (!place || handlers.isOnGround()) return;
    stage.controls.target.copy(stage.drawn(place));
    stage.controls.update();
    stage.requestFrame();
  };
  const key = (event: KeyboardEvent) => {
    if (event.ctrlKey || event.altKey || event.metaKey) return;
    const { clientWidth, clientHeight } = canvas;
    const isEnter = event.key === "Enter";
    if (isEnter) act({ offsetX: clientWidth / 2, offsetY: clientHeight / 2 });
    const isKnown =
      isEnter || (event.key === "Escape" && handlers.leave()) || pressed(stage, event);
    if (!isKnown) return;
    event.preventDefault();
    event.stopPropagation();
  };
  canvas.addEventListener("pointermove", point, { signal });
  canvas.addEventListener("pointerleave", () => handlers.over(null), { signal });
  canvas.addEventListener("pointerdown", press, { signal });
  canvas.addEventListener("click", click, { signal });
  canvas.addEventListener("dblclick", turnTo, { signal });
  canvas.addEventListener("keydown", key, { signal });
}
