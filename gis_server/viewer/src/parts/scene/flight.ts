/** Where the view is seen from: over all of it, near a stop, or from where a stop's cameras were. */

import type { Object3D } from "three";
import type { Body, Place3, SceneStop } from "../../server/scene";
import { sum } from "./geometry";
import type { Marker } from "./marker";
import { MAST } from "./rover";
import type { Stage } from "./stage";
import { standAt } from "./standing";

/** Unit direction from the middle to the eye at first: the south, 40 degrees high. */
const FROM: Place3 = [0, -0.766, 0.643];
/** Distance from which a stop is looked at. */
const NEAR_M = 9;

export class Flight {
  private land: (() => void) | null = null;

  constructor(
    private readonly stage: Stage,
    private readonly marker: Marker,
    private readonly rover: Object3D,
    /** Diagonal of all ground, metres. */
    private readonly size: number,
  ) {}

  get isStanding(): boolean {
    return this.land !== null;
  }

  over(): void {
    this.land?.();
    const { origin } = this.stage;
    const middle = this.marker.ground([origin[0], origin[1]]) ?? origin;
    this.stage.look(sum(middle, FROM, this.stage.distanceFor(this.size)), middle);
  }

  near(place: Place3): void {
    this.land?.();
    this.stage.look(sum(place, FROM, NEAR_M), place);
  }

  /** Stands at a stop; the mast is out of the way of who looks from its top. */
  stand(stop: SceneStop, body: Body | null): void {
    this.land?.();
    const release = standAt(this.stage, stop, body);
    const mast = this.rover.getObjectByName(MAST);
    if (mast) mast.visible = false;
    this.land = () => {
      release();
      if (mast) mast.visible = true;
      this.land = null;
    };
  }

  /** From standing back to flying; false for who flies already. */
  leave(): boolean {
    if (!this.isStanding) return false;
    this.over();
    return true;
  }
}
