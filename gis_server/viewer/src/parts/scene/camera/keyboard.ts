/**
 * The 3D view by keyboard: arrows turn about the target, with Shift they move it, + and -
 * zoom.
 */

import { Vector3 } from "three";
import type { Stage } from "../stage";

const TURN = Math.PI / 36;
const NEARER = 0.85;
/** A step aside as a share of the distance. */
const ASIDE = 0.05;

function shift(stage: Stage, right: number, ahead: number): void {
  const { camera, controls } = stage;
  const step = ASIDE * camera.position.distanceTo(controls.target);
  const view = controls.target.clone().sub(camera.position).setZ(0).normalize();
  const aside = new Vector3(view.y, -view.x, 0);
  const move = view.multiplyScalar(ahead * step).addScaledVector(aside, right * step);
  camera.position.add(move);
  controls.target.add(move);
  controls.update();
  stage.requestFrame();
}

/** Carries out the command of a key; false for keys without a command. */
export function pressed(
  stage: Stage,
  { key, shiftKey }: Pick<KeyboardEvent, "key" | "shiftKey">,
): boolean {
  const [right, up] =
    { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] }[key] ?? [];
  if (right !== undefined && up !== undefined) {
    if (shiftKey) shift(stage, right, up);
    else stage.orbit({ azimuth: right * TURN, elevation: up * TURN });
    return true;
  }
  if (key === "+" || key === "=") stage.orbit({ scale: NEARER });
  else if (key === "-") stage.orbit({ scale: 1 / NEARER });
  else return false;
  return true;
}
