import { expect, test } from "vitest";
import { fade } from "./painting";

const opaque = (pixels: number) => new Uint8ClampedArray(4 * pixels).fill(255);
const alphas = (pixels: Uint8ClampedArray) => pixels.filter((_, at) => at % 4 === 3);

test("opacity falls with the standard deviation, and what is not known is not drawn", () => {
  const sigmas = Float32Array.of(0, 0.15, 0.2, 0.4, Number.NaN);
  expect([...alphas(fade(opaque(5), sigmas, 0.2))]).toEqual([255, 64, 0, 0, 0]);
});

test("without any standard deviation nothing is drawn", () => {
  expect([...alphas(fade(opaque(2), null, 0.2))]).toEqual([0, 0]);
});
