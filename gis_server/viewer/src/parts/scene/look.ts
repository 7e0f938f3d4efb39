/** Where the 3D view is seen from, in the link: `east,north,up` of the eye and of what it looks at, metres. */

import type { Place3 } from "../../server/scene";

export interface Look {
  readonly from: Place3;
  readonly to: Place3;
}

const CENTIMETRES = 2;

export const formatLook = ({ from, to }: Look): string =>
  [...from, ...to].map((metres) => Number(metres.toFixed(CENTIMETRES))).join(",");

/** Null if the text is no look. */
export function parseLook(text: string | null): Look | null {
  const numbers = (text ?? "").split(",").map(Number);
  if (numbers.length !== 6 || !numbers.every(Number.isFinite)) return null;
  const [a = 0, b = 0, c = 0, d = 0, e = 0, f = 0] = numbers;
  return { from: [a, b, c], to: [d, e, f] };
}
