/** Converts values to the colours of pixels. */

import { lookup } from "./ramps";
import type { Colouring } from "./raster-style";

export type Pen = (values: Float32Array) => Uint8ClampedArray<ArrayBuffer>;

/** Turns values into red, green, blue, opacity; transparent where nothing is known or below the floor. */
export function pen({ colours, low, high, floor }: Colouring): Pen {
  const table = new Uint32Array(lookup(colours).buffer);
  const scale = 255 / (high - low);
  const least = floor ?? Number.NEGATIVE_INFINITY;
  return (values) => {
    const pixels = new Uint32Array(values.length);
    for (let at = 0; at < pixels.length; at += 1) {
      const value = values[at] as number;
      if (!(value >= least)) continue; // also NaN
      const step = (value - low) * scale;
      pixels[at] = table[step < 0 ? 0 : step > 255 ? 255 : Math.round(step)] as number;
    }
    return new Uint8ClampedArray(pixels.buffer);
  };
}

/** Takes opacity from pixels in proportion to standard deviations: all of it from `most` on, or where none is known. */
export function fade(
  pixels: Uint8ClampedArray<ArrayBuffer>,
  sigmas: Float32Array | null,
  most: number,
): Uint8ClampedArray<ArrayBuffer> {
  for (let at = 3; at < pixels.length; at += 4) {
    const share = 1 - (sigmas?.[at >> 2] ?? Number.NaN) / most;
    pixels[at] = share > 0 ? (pixels[at] as number) * Math.min(1, share) : 0; // NaN: no standard deviation
  }
  return pixels;
}

/** An image of `side` x `side` pixels. */
export function canvasOf(pixels: Uint8ClampedArray<ArrayBuffer>, side: number): HTMLCanvasElement {
  const canvas = document.createElement("canvas");
  canvas.width = side;
  canvas.height = side;
  canvas.getContext("2d")?.putImageData(new ImageData(pixels, side, side), 0, 0);
  return canvas;
}
