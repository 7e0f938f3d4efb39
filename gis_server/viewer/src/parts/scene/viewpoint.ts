/**
 * The 3D view in the link: `view3d` is `east,north,up` of the eye and of what it looks at, metres; `show3d` is what is
 * shown besides, `layer/stop/stand`: the kind of layer over the ground, the stop if one is chosen, whether the eye is
 * at that stop.
 */

import type { Place3 } from "../../server/scene";

export interface Viewpoint {
  readonly from: Place3;
  readonly to: Place3;
}

export interface Shown {
  readonly drape: string;
  readonly stop: string | null;
  readonly isStanding: boolean;
}

const CENTIMETRES = 2;
const STAND = "stand";

export const formatViewpoint = ({ from, to }: Viewpoint): string =>
  [...from, ...to].map((metres) => Number(metres.toFixed(CENTIMETRES))).join(",");

/** Null if the text is not such a view. */
export function parseViewpoint(text: string | null): Viewpoint | null {
  const numbers = (text ?? "").split(",").map(Number);
  if (numbers.length !== 6 || !numbers.every(Number.isFinite)) return null;
  const [a = 0, b = 0, c = 0, d = 0, e = 0, f = 0] = numbers;
  return { from: [a, b, c], to: [d, e, f] };
}

/** Nothing for what is shown at first. */
export const formatShown = ({ drape, stop, isStanding }: Shown): string =>
  [drape, stop ?? "", isStanding ? STAND : ""].join("/").replace(/\/+$/, "");

export function parseShown(text: string | null): Shown {
  const [drape = "", stop = "", stand = ""] = (text ?? "").split("/");
  return { drape, stop: stop || null, isStanding: stand === STAND };
}
