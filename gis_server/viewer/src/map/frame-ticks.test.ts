import { expect, test } from "vitest";
import { roundStep, ticks } from "./frame-ticks";

test.each([
  [0.3, 0.5],
  [1, 1],
  [1.1, 2],
  [11, 20],
  [51, 100],
])("at least %s metres apart is every %s", (least, step) => {
  expect(roundStep(least)).toBeCloseTo(step, 9);
});

test("ticks are round, and where their coordinate is on the screen", () => {
  const found = ticks(3, 0.05, 800, 110); // from -17 to 23 m, 5.5 m apart at least
  expect(found.map(({ metres }) => metres)).toEqual([-10, 0, 10, 20]);
  expect(found[1]?.px).toBeCloseTo(400 - 3 / 0.05, 6);
});

test("to the north is up: from the top of the map downwards", () => {
  const [south, north] = ticks(0, -0.1, 400, 110);
  expect(north && south && north.px < south.px).toBe(true);
});
