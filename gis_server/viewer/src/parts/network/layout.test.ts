import { expect, test } from "vitest";
import { edgeWidth, pairSpots, SIDE, spread, stopSpots } from "./layout";

test("stops stand as on the map, north up", () => {
  const spots = stopSpots([
    { stop: "a", place: [0, 0, 0] },
    { stop: "b", place: [10, 20, 0] },
  ]);
  const [a, b] = [spots.get("a"), spots.get("b")];
  if (!a || !b) throw new Error("a stop has no spot");
  expect(b.x - a.x).toBeCloseTo((a.y - b.y) / 2, 9);
  expect(b.y).toBeLessThan(a.y);
  for (const value of [a.x, a.y, b.x, b.y]) expect(value >= 0 && value <= SIDE).toBe(true);
});

test("a single stop is in the middle", () => {
  expect(stopSpots([{ stop: "a", place: [3, 4, 0] }]).get("a")).toEqual({ x: 500, y: 500 });
});

test("directions far enough apart stay, others are moved apart in their order", () => {
  expect(spread([90, 0, 180])).toEqual([90, 0, 180]);
  const close = spread([10, 10, 10, 10]);
  const sorted = [...close].sort((a, b) => a - b);
  for (let k = 1; k < 4; k += 1)
    expect((sorted[k] ?? 0) - (sorted[k - 1] ?? 0)).toBeGreaterThan(62);
  expect((sorted[3] ?? 0) - (sorted[0] ?? 0)).toBeLessThan(360);
});

test("a pair stands where it looks; those of other stops stand outside", () => {
  const facts = { sol: 1, instrument: "NAVCAM", elevation_deg: 0, ties: 1, blunders: 0, weak: [] };
  const spots = pairSpots({
    stop: "a",
    pairs: [
      { ...facts, id: "east", stop: "a", azimuth_deg: 90 },
      { ...facts, id: "other", stop: "b", azimuth_deg: 90 },
    ],
  });
  const [east, other] = [spots.get("east"), spots.get("other")];
  expect(east?.y).toBeCloseTo(SIDE / 2, 9);
  expect((other?.x ?? 0) > (east?.x ?? 0) && (east?.x ?? 0) > SIDE / 2).toBe(true);
});

test("more ties, wider edges", () => {
  expect(edgeWidth(400)).toBeGreaterThan(edgeWidth(40));
});
