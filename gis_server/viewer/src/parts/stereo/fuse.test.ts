import { expect, test } from "vitest";
import type { ImageEntry } from "../../server/records";
import { bestParallax, type Grey, moved, pairOf, pairsOf, whole, zoomed } from "./fuse";

const image = (id: string, eye: string, partner: string | null): ImageEntry => ({
  id,
  eye,
  partner,
  stop: "s",
  site: 1,
  drive: 2,
  sol: 3,
  instrument: "NAVCAM",
  product_type: "EDR",
  local_solar_time: null,
  start_time: null,
  unpaired_because: null,
  browse: null,
  original: null,
});
const IMAGES = [image("L", "left", "R"), image("R", "right", "L"), image("A", "left", null)];

test("a pair is the same from either of its images", () => {
  expect(pairOf(IMAGES, "R")?.left.id).toBe("L");
  expect(pairOf(IMAGES, "L")?.right.id).toBe("R");
  expect(pairOf(IMAGES, "A")).toBeNull();
  expect(pairsOf(IMAGES)).toHaveLength(1);
});

/** Noise that is the same at the same place of the scene. */
function scene(parallax: number): Grey {
  const [width, height] = [96, 32];
  const values = new Float32Array(width * height);
  for (let row = 0; row < height; row += 1)
    for (let x = 0; x < width; x += 1) {
      const at = (x + parallax) * 12.9898 + row * 78.233;
      values[row * width + x] = 128 + 100 * Math.sin(at * at);
    }
  return { width, height, values };
}

test.each([0, 5, 17])("a parallax of %i pixels is found", (parallax) => {
  expect(bestParallax(scene(0), scene(parallax), 30)).toBe(parallax);
});

test("images without contrast are not shifted", () => {
  const flat = { width: 8, height: 2, values: new Float32Array(16).fill(7) };
  expect(bestParallax(flat, flat, 4)).toBe(0);
});

test("the whole image fits, and the point under the pointer stays there", () => {
  const sight = whole(1000, 500, 400, 400);
  expect(sight).toEqual({ scale: 0.4, x: 500, y: 250 });
  const near = zoomed(sight, 2, 100, -50);
  const under = (s: typeof sight) => [s.x + 100 / s.scale, s.y - 50 / s.scale];
  expect(under(near)).toEqual(under(sight));
  expect(moved(sight, 40, 0).x).toBe(400);
});
