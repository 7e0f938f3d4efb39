/** Looking around from where the rover's cameras were: at mast height, ahead. */

import type { Body, SceneStop } from "../../../server/scene";
import { headingDeg, onMap, sum, sunDirection } from "../geometry";
import { mastHead } from "../rover";
import type { Stage } from "../stage";

/** The orbited target is this near to the eye, so that orbiting is looking around. */
const NEAR_M = 0.02;
const WIDE_DEG = 60;
const [LEAST_DEG, MOST_DEG] = [10, 100];
const STANDING_M = 1.5;
const DIP_DEG = -12;

/** Moves the camera there; the returned function returns to flying. */
export function standAt(stage: Stage, stop: SceneStop, body: Body | null): () => void {
  const { camera, controls, renderer } = stage;
  const eye = onMap(stop, body ? mastHead(body) : [0, 0, -STANDING_M]);
  const ahead = sunDirection(headingDeg(stop), DIP_DEG);
  const before = { fov: camera.fov, speed: controls.rotateSpeed };
  camera.fov = WIDE_DEG;
  controls.rotateSpeed = -0.3;
  controls.enableZoom = controls.enablePan = false;
  const zoom = (event: WheelEvent) => {
    event.preventDefault();
    const wider = camera.fov * Math.exp(event.deltaY / 800);
    camera.fov = Math.min(MOST_DEG, Math.max(LEAST_DEG, wider));
    camera.updateProjectionMatrix();
    stage.requestFrame();
  };
  renderer.domElement.addEventListener("wheel", zoom, { passive: false });
  camera.updateProjectionMatrix();
  stage.look(eye, sum(eye, ahead, NEAR_M));
  return () => {
    renderer.domElement.removeEventListener("wheel", zoom);
    camera.fov = before.fov;
    controls.rotateSpeed = before.speed;
    controls.enableZoom = controls.enablePan = true;
    camera.updateProjectionMatrix();
  };
}
