/** The path along the traverse, and the movement of the eye along it. */

import type { Place3 } from "../../../server/scene";
import { sum } from "../geometry";
import type { Stage } from "../stage";

const EYE_M = 1.5;
/** Position of the target: this far ahead on the path, and this much below the eye. */
const AHEAD_M = 6;
const DIP_M = 1;
/** Time constant of following the height of the ground, so that stones are climbed smoothly. */
const SMOOTH_S = 0.6;
/** Longest time step of a frame: the page may have been hidden. */
const LONGEST_S = 0.25;

const along = (a: Place3, b: Place3, share: number): Place3 => [
  a[0] + share * (b[0] - a[0]),
  a[1] + share * (b[1] - a[1]),
  a[2] + share * (b[2] - a[2]),
];

/** The place at a distance along a path, which continues straight beyond its ends. */
export function placeOn(way: readonly Place3[], metres: number): Place3 {
  let left = metres;
  for (let k = 1; k < way.length; k += 1) {
    const [from, to] = [way[k - 1], way[k]];
    if (!from || !to) break;
    const length = Math.hypot(to[0] - from[0], to[1] - from[1]);
    if (length > 0 && (left <= length || k === way.length - 1))
      return along(from, to, left / length);
    left -= length;
  }
  return way[0] ?? [0, 0, 0];
}

export const lengthOf = (way: readonly Place3[]) =>
  way.slice(1).reduce((metres, [e, n], k) => {
    const [east, north] = way[k] ?? [e, n];
    return metres + Math.hypot(e - east, n - north);
  }, 0);

export interface Walking {
  /** Speed, metres per second. */
  readonly speed: () => number;
  /** The ground at a place of the path; null: unknown. */
  readonly ground: (place: Place3) => Place3 | null;
  readonly at: (place: Place3) => void;
  readonly arrived: () => void;
}

/** Moves the eye along a path; the returned function stops it. */
export function walk(stage: Stage, way: readonly Place3[], walking: Walking): () => void {
  const whole = lengthOf(way);
  let [gone, height, before] = [0, Number.NaN, performance.now()];
  let frame = 0;
  stage.controls.enabled = false;
  const step = (now: number) => {
    const seconds = Math.min(LONGEST_S, (now - before) / 1000);
    before = now;
    gone = Math.min(whole, gone + seconds * walking.speed());
    const place = placeOn(way, gone);
    const ground = walking.ground(place)?.[2] ?? place[2];
    height = Number.isNaN(height)
      ? ground
      : height + (ground - height) * (1 - Math.exp(-seconds / SMOOTH_S));
    const eye: Place3 = [place[0], place[1], height + EYE_M];
    const next = placeOn(way, gone + AHEAD_M);
    stage.look(eye, [next[0], next[1], eye[2] - DIP_M]);
    walking.at([place[0], place[1], ground]);
    if (gone < whole) frame = requestAnimationFrame(step);
    else walking.arrived();
  };
  frame = requestAnimationFrame(step);
  return () => {
    cancelAnimationFrame(frame);
    stage.controls.enabled = true;
  };
}

/** The ground below the rovers along a path. */
export const groundWay = (places: readonly Place3[], groundM: number): Place3[] =>
  places.map((place) => sum(place, [0, 0, -1], groundM));
