import { expect, test } from "vitest";
import { rasterLayer, vectorLayer } from "../fixtures";
import { coarsest, isNeeded } from "./extent-of-need";

const VIEW = [0, 0, 100, 100] as const;
const contours = { ...vectorLayer("mer2-site0010-drive0064", "contours"), bounds: VIEW };

test("contours of a stop are fetched where the stop is on the screen and large enough", () => {
  expect(isNeeded(contours, [50, 50, 60, 60], 0.1)).toBe(true);
  expect(isNeeded(contours, [200, 50, 260, 60], 0.1)).toBe(false);
  expect(isNeeded(contours, [-4000, -4000, 4000, 4000], 8)).toBe(false);
});

test("what lies over the whole mission is always there", () => {
  expect(coarsest(vectorLayer("mer2", "traverse"))).toBe(Number.POSITIVE_INFINITY);
  expect(coarsest(rasterLayer("mer2-site0010-drive0064", "orthophoto"))).toBe(
    Number.POSITIVE_INFINITY,
  );
});

test("footprints are drawn from sixty pixels on, tie points when they stand apart", () => {
  expect(isNeeded(vectorLayer("mer2", "footprints"), VIEW, 0.5)).toBe(true);
  expect(isNeeded(vectorLayer("mer2", "footprints"), VIEW, 0.51)).toBe(false);
  expect(isNeeded(vectorLayer("mer2", "tie-points"), VIEW, 1)).toBe(false);
});
