/** Positions of the camera: above all ground, near a stop, at a stop's cameras, or along the traverse. */

import type { Object3D } from "three";
import type { Body, Place3, SceneStop } from "../../../server/scene";
import { sum } from "../geometry";
import type { Marker } from "../marker";
import { MAST } from "../rover";
import type { Stage } from "../stage";
import { standAt } from "./standing";
import { groundWay, walk, type Walking } from "./walk";

/** Unit direction from the middle to the eye at first: the south, 40 degrees high. */
const FROM: Place3 = [0, -0.766, 0.643];
/** Distance from which a stop is looked at. */
const NEAR_M = 9;

export class Flight {
  private land: (() => void) | null = null;
  isWalking = false;

  constructor(
    private readonly stage: Stage,
    private readonly marker: Marker,
    private readonly rover: Object3D,
    /** Diagonal of all ground, metres. */
    private readonly size: number,
    /** Called with the new viewpoint. */
    private readonly placed: (at: "flying" | "standing" | "walking") => void,
  ) {}

  /** Standing or walking. */
  get isOnGround(): boolean {
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

  /** Moves to the cameras of a stop; the mast is hidden so that it does not obstruct the view. */
  stand(stop: SceneStop, body: Body | null): void {
    this.land?.();
    const release = standAt(this.stage, stop, body);
    const mast = this.rover.getObjectByName(MAST);
    if (mast) mast.visible = false;
    this.land = () => {
      release();
      if (mast) mast.visible = true;
      this.land = null;
      this.placed("flying");
    };
    this.placed("standing");
  }

  /** Walks from the first stop to the last, and stays there. */
  walk(
    stops: readonly SceneStop[],
    body: Body | null,
    walking: Omit<Walking, "ground" | "arrived">,
  ) {
    this.land?.();
    const way = groundWay(
      stops.map(({ place }) => place),
      body?.ground_m ?? 0,
    );
    const halt = walk(this.stage, way, {
      ...walking,
      ground: ([east, north]) => this.marker.ground([east, north]),
      arrived: () => this.land?.(),
    });
    this.isWalking = true;
    this.land = () => {
      halt();
      this.isWalking = false;
      this.land = null;
      this.placed("flying");
    };
    this.placed("walking");
    this.rover.visible = false; // the path leads through it
  }

  /** Ends standing and walking without moving the eye. */
  halt(): void {
    this.land?.();
  }

  /** Returns from the ground to flying; false if it flies already. */
  leave(): boolean {
    if (!this.isOnGround) return false;
    this.over();
    return true;
  }
}
