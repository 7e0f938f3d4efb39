/**
 * A rover of boxes and wheels, to scale, in the rover frame (forward, right, down; the origin between the middle
 * wheels).
 *
 * The box is the one with which the adjustment identifies pixels that show the rover itself. Wheels of Spirit and
 * Opportunity are 0.26 m across and 1.41 m from the first axle to the last; those of Curiosity and Perseverance 0.5 m
 * and 2.2 m. The mast carries its cameras 1.5 m (2.1 m) above the ground.
 */

import {
  BoxGeometry,
  CylinderGeometry,
  Group,
  Matrix4,
  Mesh,
  MeshLambertMaterial,
  type Object3D,
  type Vector3,
} from "three";
import type { Body, Place3, SceneStop } from "../../server/scene";

interface Parts {
  readonly wheel_m: number;
  readonly tread_m: number;
  readonly axles_m: number;
  readonly mast_m: number;
}
const SMALL: Parts = { wheel_m: 0.26, tread_m: 0.16, axles_m: 1.41, mast_m: 1.5 };
const LARGE: Parts = { wheel_m: 0.5, tread_m: 0.4, axles_m: 2.2, mast_m: 2.1 };
/** Longer bodies have the wheels of the second size, metres. */
const LONG_M = 2.5;
/** Track of the wheels over the width of the panels: 1.06 m of 2.3 m. */
const TRACK = 0.46;
const LARGE_TRACK = 0.8;
const PANEL_M = 0.03;
/** Name of the part that obstructs the view from its top. */
export const MAST = "mast";

export function partsOf({ back_m, front_m }: Body): Parts {
  return back_m + front_m > LONG_M ? LARGE : SMALL;
}

function box(
  size: readonly [number, number, number],
  at: readonly [number, number, number],
  color: number,
) {
  const mesh = new Mesh(new BoxGeometry(...size), new MeshLambertMaterial({ color }));
  mesh.position.set(...at);
  return mesh;
}

/** The point between the cameras on the mast, in the rover frame. */
export function mastHead(body: Body): Place3 {
  return [0.5 * body.front_m, 0, body.ground_m - partsOf(body).mast_m];
}

function mastOf(body: Body): Group {
  const mast = new Group();
  const [front, side, head] = mastHead(body);
  const length = partsOf(body).mast_m - body.deck_m;
  mast.add(box([0.06, 0.06, length], [front, side, head + length / 2], 0xe8e8e8));
  mast.add(box([0.1, 0.42, 0.1], [front, side, head], 0xf5f5f5));
  mast.name = MAST;
  return mast;
}

/** The rover in its own frame. */
export function roverModel(body: Body): Group {
  const parts = partsOf(body);
  const rover = new Group();
  const { back_m, front_m, half_width_m, deck_m, ground_m } = body;
  const [length, middle] = [back_m + front_m, (front_m - back_m) / 2];
  const deck = ground_m - deck_m;
  const share = parts === LARGE ? LARGE_TRACK : TRACK;
  const track = share * half_width_m;
  rover.add(box([length, 2 * half_width_m, PANEL_M], [middle, 0, deck], 0x2c3e66));
  const hull = [0.7 * length, 1.1 * track, deck_m / 2] as const;
  rover.add(box(hull, [middle, 0, deck + deck_m / 4 + PANEL_M], 0xd9c9a3));
  rover.add(mastOf(body));
  for (const side of [-1, 1])
    for (const axle of [-0.5, 0, 0.5]) {
      const radius = parts.wheel_m / 2;
      const wheel = new Mesh(
        new CylinderGeometry(radius, radius, parts.tread_m, 20), // its axis is y: to the right
        new MeshLambertMaterial({ color: 0x4a4a4a }),
      );
      wheel.position.set(axle * parts.axles_m, side * track, ground_m - radius);
      rover.add(wheel);
    }
  return rover;
}

/** Places an object of the rover frame at the pose of a stop. */
export function stand(thing: Object3D, stop: SceneStop, at: Vector3): void {
  const [[a, b, c], [d, e, f], [g, h, i]] = stop.map_from_rover;
  const turn = new Matrix4().set(a, b, c, at.x, d, e, f, at.y, g, h, i, at.z, 0, 0, 0, 1);
  thing.matrixAutoUpdate = false;
  thing.matrix.copy(turn);
  thing.matrixWorldNeedsUpdate = true;
}
