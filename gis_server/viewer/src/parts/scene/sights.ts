/** Cameras of a stop: view pyramids, and pointing lines from them to the ground. */

import { Group, Raycaster, Vector3 } from "three";
import type { Place3, SceneCamera } from "../../server/scene";
import { discard, segments } from "./drawings";
import { pyramid, sum } from "./geometry";
import type { Stage } from "./stage";
import type { Terrain } from "./surface/terrain";

const REACH_M = 0.6;
/** A camera that looks above the ground has a line as long as the map's pointing line. */
const FAR_M = 40;
const PAIRED = "#0b8f86";
const UNPAIRED = "#b0359c";
const CHOSEN = "#ffd400";
/** Largest distance of a click from a pyramid, as a share of the range, that selects its image. */
const NEAR = 0.02;

export class Sights {
  readonly group = new Group();
  private cameras: readonly SceneCamera[] = [];
  private chosen: string | null = null;

  constructor(
    private readonly stage: Stage,
    private readonly terrain: Terrain,
  ) {}

  show(cameras: readonly SceneCamera[]): void {
    this.cameras = cameras;
    this.draw();
  }

  choose(image: string | null): void {
    this.chosen = image;
    this.draw();
  }

  /** The image whose pyramid lies at a pixel of the view; the nearest one. */
  at(x: number, y: number): string | null {
    if (!this.group.visible) return null;
    const ray = this.stage.aim(x, y).ray;
    let best: { readonly image: string; readonly distance: number } | null = null;
    for (const { image, ...camera } of this.cameras) {
      const ends = pyramid({ image, ...camera }, REACH_M);
      for (let k = 0; k < ends.length; k += 2) {
        const [from, to] = [ends[k], ends[k + 1]];
        if (!from || !to) continue;
        const met = new Vector3();
        const gap = ray.distanceSqToSegment(this.stage.drawn(from), this.stage.drawn(to), met);
        const distance = met.distanceTo(ray.origin);
        if (Math.sqrt(gap) < NEAR * distance && (!best || distance < best.distance))
          best = { image, distance };
      }
    }
    return best?.image ?? null;
  }

  /** Redraws: the ground that lines end on may have been loaded in the meantime. */
  draw(): void {
    for (const old of [...this.group.children]) discard(old);
    const { origin } = this.stage;
    const of = (some: readonly SceneCamera[]) => some.flatMap((one) => pyramid(one, REACH_M));
    const lines = (some: readonly SceneCamera[]) =>
      some.flatMap((one): Place3[] => [one.centre, this.end(one)]);
    const add = (some: readonly SceneCamera[], color: string, width: number) => {
      if (some.length === 0) return;
      this.group.add(segments(of(some), origin, { color, width }));
      this.group.add(segments(lines(some), origin, { color, width: width / 2 }));
    };
    const others = this.cameras.filter(({ image }) => image !== this.chosen);
    add(
      others.filter(({ partner }) => partner),
      PAIRED,
      1.5,
    );
    add(
      others.filter(({ partner }) => !partner),
      UNPAIRED,
      1.5,
    );
    add(
      this.cameras.filter(({ image }) => image === this.chosen),
      CHOSEN,
      4,
    );
    this.stage.requestFrame();
  }

  /** The point in which a camera's axis meets the ground. */
  private end({ centre, axis }: SceneCamera): Place3 {
    const far = sum(centre, axis, FAR_M);
    const from = this.stage.drawn(centre);
    const ray = new Raycaster(from, this.stage.drawn(far).sub(from).normalize());
    const hit = this.terrain.hit(ray);
    return hit ? this.stage.place(hit.point) : far;
  }
}
