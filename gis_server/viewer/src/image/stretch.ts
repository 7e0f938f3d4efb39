/** Contrast: the grey values shown as black and white, and gamma for those between. */

export interface Stretch {
  /** Grey values 0 to 255 of the image. */
  readonly low: number;
  readonly high: number;
  readonly gamma: number;
}

export const NO_STRETCH: Stretch = { low: 0, high: 255, gamma: 1 };

/** The stretched value of every grey value. */
export function lookUp({ low, high, gamma }: Stretch): Uint8ClampedArray {
  const span = Math.max(high - low, 1);
  return Uint8ClampedArray.from({ length: 256 }, (_, value) => {
    const share = Math.min(1, Math.max(0, (value - low) / span));
    return Math.round(255 * share ** (1 / gamma));
  });
}

/** Stretches red, green and blue of an image in place. */
export function applied(pixels: Uint8ClampedArray, table: Uint8ClampedArray): Uint8ClampedArray {
  const result = new Uint8ClampedArray(pixels.length);
  for (let k = 0; k < pixels.length; k += 4) {
    result[k] = table[pixels[k] ?? 0] ?? 0;
    result[k + 1] = table[pixels[k + 1] ?? 0] ?? 0;
    result[k + 2] = table[pixels[k + 2] ?? 0] ?? 0;
    result[k + 3] = pixels[k + 3] ?? 255;
  }
  return result;
}

/** The stretch that leaves a share of the pixels, half of it at either end, black or white. */
export function percentileStretch(pixels: Uint8ClampedArray, share: number): Stretch {
  const counts = new Uint32Array(256);
  for (let k = 0; k < pixels.length; k += 4) {
    const green = pixels[k + 1] ?? 0;
    counts[green] = (counts[green] ?? 0) + 1;
  }
  const tail = (share / 2) * (pixels.length / 4);
  const first = (values: readonly number[]) => {
    let sum = 0;
    return values.find((value) => (sum += counts[value] ?? 0) > tail) ?? 0;
  };
  const rising = Array.from({ length: 256 }, (_, value) => value);
  const [low, high] = [first(rising), first([...rising].reverse())];
  return { low, high: Math.max(high, low + 1), gamma: 1 };
}
