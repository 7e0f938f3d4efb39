/**
 * Cast shadows of the ground.
 *
 * Cells are visited from the sun's side. H is the height up to which a place is in the shadow of earlier cells, or the
 * ground itself; a step of length s away from the sun lowers the shadow by s tan E:
 *
 *     incoming = H(one step towards the sun) - s tan E          shadow where incoming > z
 *     H = max(z, incoming)
 *
 * The step goes to the next column (or row, whichever the sun's direction is closer to), and H is interpolated between
 * the two cells it falls between. Ground that was not measured has no height and lets shadows pass.
 */

import type { SunPlace } from "./shading";

const DEG = Math.PI / 180;

export interface Ground {
  /** Heights row by row from the north-west; NaN where not measured. */
  readonly heights: Float32Array;
  readonly columns: number;
  readonly rows: number;
  readonly cell_m: number;
}

/** 1 in shadow, else 0, also where the ground is unknown. */
export function shadows(ground: Ground, { azimuthDeg, elevationDeg }: SunPlace): Uint8Array {
  const { heights, columns, rows, cell_m } = ground;
  if (elevationDeg <= 0) return Uint8Array.from(heights, (z) => (Number.isNaN(z) ? 0 : 1));
  const toEast = Math.sin(azimuthDeg * DEG);
  const toSouth = -Math.cos(azimuthDeg * DEG);
  const alongColumns = Math.abs(toEast) >= Math.abs(toSouth);
  // Main steps go along the axis that the sun is closer to; `side` is the shift across it.
  const [main, across] = alongColumns ? [toEast, toSouth] : [toSouth, toEast];
  const [count, width] = alongColumns ? [columns, rows] : [rows, columns];
  const [stepMain, stepAcross] = alongColumns ? [1, columns] : [columns, 1];
  const side = across / Math.abs(main);
  const fall = cell_m * Math.hypot(1, side) * Math.tan(elevationDeg * DEG);
  const found = new Uint8Array(heights.length);
  let before = new Float32Array(width).fill(Number.NEGATIVE_INFINITY);
  let here = new Float32Array(width);
  for (let k = 0; k < count; k += 1) {
    const place = main > 0 ? count - 1 - k : k;
    for (let j = 0; j < width; j += 1) {
      const at = place * stepMain + j * stepAcross;
      const incoming = between(before, j + side) - fall;
      const z = heights[at] as number;
      if (incoming > z) found[at] = 1;
      here[j] = z > incoming ? z : incoming; // unknown ground: the shadow alone
    }
    [before, here] = [here, before];
  }
  return found;
}

function between(line: Float32Array, at: number): number {
  const k = Math.floor(at);
  const [a, b] = [line[k], line[k + 1]];
  const share = at - k;
  if (a === undefined || share === 1) return b ?? Number.NEGATIVE_INFINITY;
  if (b === undefined || share === 0) return a;
  // Where one of the two is in the open, the shadow's edge lies between them.
  return a + (b - a) * share || Number.NEGATIVE_INFINITY;
}
