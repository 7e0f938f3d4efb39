/** Images of a stereo pair: epipolar where the pair was matched, else the browse images. */

import { ApiError } from "./api";
import type { ImageEntry } from "./records";

export interface PairImages {
  readonly left: ImageBitmap;
  readonly right: ImageBitmap;
  /** Rows of both correspond exactly. */
  readonly isLinearised: boolean;
}

async function load(url: string, signal: AbortSignal): Promise<ImageBitmap | null> {
  const response = await fetch(url, { signal });
  return response.ok ? createImageBitmap(await response.blob()) : null;
}

const both = (left: string, right: string, signal: AbortSignal) =>
  Promise.all([load(left, signal), load(right, signal)]);

export async function loadPairImages(
  left: ImageEntry,
  right: ImageEntry,
  signal: AbortSignal,
): Promise<PairImages> {
  const linearised = ({ id }: ImageEntry) => `images/${encodeURIComponent(id)}/linearised.png`;
  const [a, b] = await both(linearised(left), linearised(right), signal);
  if (a && b) return { left: a, right: b, isLinearised: true };
  if (left.browse && right.browse) {
    const [c, d] = await both(left.browse, right.browse, signal);
    if (c && d) return { left: c, right: d, isLinearised: false };
  }
  throw new ApiError(`the pair ${left.id} and ${right.id} has no images to show`);
}
