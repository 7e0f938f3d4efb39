import { expect, test } from "vitest";
import { scaleBar } from "./scale";

test.each([
  [0.01, "1 m", 100],
  [0.05, "5 m", 100],
  [0.1, "10 m", 100],
  [0.0004, "5 cm", 125],
  [12.5, "2 km", 160],
])("at %d metres a pixel the bar is labelled %s", (resolution, label, px) => {
  const bar = scaleBar(resolution, 160);
  expect(bar.label).toBe(label);
  expect(bar.px).toBeCloseTo(px, 6);
});

test("a bar fits, is no shorter than 2/5 of its room, and has the length of its label", () => {
  for (let k = 0; k < 200; k += 1) {
    const resolution = 0.001 * 1.07 ** k;
    const { px, metres } = scaleBar(resolution, 160);
    expect(px).toBeLessThanOrEqual(160.001);
    expect(px).toBeGreaterThanOrEqual(63.999);
    expect(px * resolution).toBeCloseTo(metres, 9);
  }
});
