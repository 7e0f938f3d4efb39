/**
 * Stereo pairs without drawing: which images belong together, and by how much one is shifted so that eyes can fuse
 * them.
 *
 * A point lies at x in the left image and at x - p in the right one, with the parallax p > 0. The right image is
 * drawn `nudge` pixels to the right: points with p = nudge lie on the screen, nearer ones before it.
 */

import type { ImageEntry } from "../../server/records";

export interface Pair {
  readonly left: ImageEntry;
  readonly right: ImageEntry;
}

/** The pair that an image belongs to; null for one without partner. */
export function pairOf(images: readonly ImageEntry[], id: string): Pair | null {
  const one = images.find((image) => image.id === id);
  const other = one && images.find((image) => image.id === one.partner);
  if (!one || !other) return null;
  return one.eye === "right" ? { left: other, right: one } : { left: one, right: other };
}

export function pairsOf(images: readonly ImageEntry[]): readonly Pair[] {
  return images.flatMap((image) => {
    const pair = image.eye === "left" ? pairOf(images, image.id) : null;
    return pair ? [pair] : [];
  });
}

/** Grey values, row by row. */
export interface Grey {
  readonly width: number;
  readonly height: number;
  readonly values: ArrayLike<number>;
}

/**
 * The parallax, from 0 to `most` pixels, at which two images are most alike: largest correlation of their overlap. It
 * is that of the ground that fills most of them.
 */
export function bestParallax(left: Grey, right: Grey, most: number): number {
  let [best, likest] = [0, Number.NEGATIVE_INFINITY];
  for (let parallax = 0; parallax <= most; parallax += 1) {
    const alike = correlation(left, right, parallax);
    if (alike > likest) [best, likest] = [parallax, alike];
  }
  return best;
}

function correlation(left: Grey, right: Grey, parallax: number): number {
  const { width, height } = left;
  let [n, a, b, aa, bb, ab] = [0, 0, 0, 0, 0, 0];
  for (let row = 0; row < height; row += 1)
    for (let x = parallax; x < width; x += 1) {
      const u = left.values[row * width + x] ?? 0;
      const v = right.values[row * width + x - parallax] ?? 0;
      n += 1;
      a += u;
      b += v;
      aa += u * u;
      bb += v * v;
      ab += u * v;
    }
  const spread = (aa - (a * a) / n) * (bb - (b * b) / n);
  return n > 0 && spread > 0 ? (ab - (a * b) / n) / Math.sqrt(spread) : Number.NEGATIVE_INFINITY;
}

/** The visible part of the images: `scale` pixels of the screen per pixel, its middle at (x, y). */
export interface Sight {
  readonly scale: number;
  readonly x: number;
  readonly y: number;
}

export function whole(width: number, height: number, roomX: number, roomY: number): Sight {
  return { scale: Math.min(roomX / width, roomY / height), x: width / 2, y: height / 2 };
}

/** Nearer by a factor, so that what lies `dx`, `dy` from the middle of the screen stays there. */
export function zoomed(sight: Sight, factor: number, dx: number, dy: number): Sight {
  const scale = Math.min(16, Math.max(0.05, sight.scale * factor));
  const held = 1 / sight.scale - 1 / scale;
  return { scale, x: sight.x + dx * held, y: sight.y + dy * held };
}

export const moved = (sight: Sight, dx: number, dy: number): Sight => ({
  ...sight,
  x: sight.x - dx / sight.scale,
  y: sight.y - dy / sight.scale,
});
