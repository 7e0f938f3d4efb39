/** The cursor in space: a pole on the ground at the place that the map, a profile or the view itself points at. */

import { Raycaster, Vector3 } from "three";
import type { MapPoint } from "../../server/records";
import type { Place3 } from "../../server/scene";
import { discard, segments } from "./drawings";
import type { Stage } from "./stage";
import type { Terrain } from "./surface/terrain";

const HIGH_M = 1000;
/** Height of the pole as a share of its distance from the eye. */
const TALL = 0.08;

export class Marker {
  private shown: ReturnType<typeof segments>[] = [];

  constructor(
    private readonly stage: Stage,
    private readonly terrain: Terrain,
  ) {}

  /** The ground below a point of the map; null where the models have none. */
  ground([east, north]: MapPoint): Place3 | null {
    const from = this.stage.drawn([east, north, this.stage.origin[2] + HIGH_M]);
    const down = new Raycaster(from, new Vector3(0, 0, -1));
    const hit = this.terrain.hit(down);
    return hit ? this.stage.place(hit.point) : null;
  }

  at(point: MapPoint | null): Place3 | null {
    for (const old of this.shown) discard(old);
    this.shown = [];
    const ground = point && this.ground(point);
    if (ground) this.draw(ground);
    this.stage.requestFrame();
    return ground;
  }

  private draw(foot: Place3): void {
    const { origin, exaggeration, camera, world } = this.stage;
    const tall = TALL * camera.position.distanceTo(this.stage.drawn(foot));
    const top: Place3 = [foot[0], foot[1], foot[2] + tall / exaggeration];
    const arm = tall / 4;
    const cross: Place3[] = [foot, top];
    for (const [x, y] of [
      [arm, 0],
      [0, arm],
    ] as const)
      cross.push([foot[0] - x, foot[1] - y, foot[2]], [foot[0] + x, foot[1] + y, foot[2]]);
    this.shown = [
      segments(cross, origin, { color: "#000000", width: 4, above: true }),
      segments(cross, origin, { color: "#ffd400", width: 2, above: true }),
    ];
    world.add(...this.shown);
  }
}
