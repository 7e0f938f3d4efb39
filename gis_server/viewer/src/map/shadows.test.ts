import { expect, test } from "vitest";
import { type Ground, shadows } from "./shadows";

const SIDE = 41;
const MID = 20;

/** Level ground of 0.5 m cells with something on it. */
function ground(height: (row: number, column: number) => number): Ground {
  const heights = new Float32Array(SIDE * SIDE);
  for (let row = 0; row < SIDE; row += 1)
    for (let column = 0; column < SIDE; column += 1)
      heights[row * SIDE + column] = height(row, column);
  return { heights, columns: SIDE, rows: SIDE, cell_m: 0.5 };
}

const wall = (across: "row" | "column") =>
  ground((row, column) => ((across === "row" ? row : column) === MID ? 2.9 : 0));
const inShadow = (found: Uint8Array, row: number, column: number) => found[row * SIDE + column];

/** Cells in shadow along a line from the middle. */
function length(found: Uint8Array, [down, right]: readonly [number, number]): number {
  let cells = 0;
  while (inShadow(found, MID + down * (cells + 1), MID + right * (cells + 1))) cells += 1;
  return cells;
}

test.each([
  [270, "column", [0, 1]],
  [90, "column", [0, -1]],
  [0, "row", [1, 0]],
  [180, "row", [-1, 0]],
] as const)(
  "a wall with the sun at azimuth %d throws its shadow away from it",
  (azimuthDeg, across, to) => {
    const found = shadows(wall(across), { azimuthDeg, elevationDeg: 45 });
    expect(length(found, to)).toBe(5); // 2.9 m of shadow on cells of 0.5 m
    expect(length(found, [-to[0], -to[1]] as never)).toBe(0);
  },
);

test("a lower sun throws a longer shadow", () => {
  const elevationDeg = (Math.atan(2.9 / 9.25) * 180) / Math.PI;
  expect(length(shadows(wall("column"), { azimuthDeg: 270, elevationDeg }), [0, 1])).toBe(18);
});

test("a wall in the meridian throws an oblique shadow as far across as the sun's rays go", () => {
  const sun = { azimuthDeg: 225, elevationDeg: 45 };
  // Across the wall a ray of 45 degrees azimuth loses 1 m of height in 0.71 m.
  expect(length(shadows(wall("column"), sun), [0, 1])).toBe(4);
});

test("level ground has no shadow, and ground above the rays has none either", () => {
  expect(
    shadows(
      ground(() => 1),
      { azimuthDeg: 33, elevationDeg: 5 },
    ).some(Boolean),
  ).toBe(false);
  const ramp = ground((_, column) => column * 0.25); // 26.6 degrees, rising to the east
  expect(shadows(ramp, { azimuthDeg: 90, elevationDeg: 30 }).some(Boolean)).toBe(false);
  const dark = shadows(ramp, { azimuthDeg: 90, elevationDeg: 20 });
  expect(inShadow(dark, MID, MID)).toBe(1);
});

test("shadows pass over ground that was not measured, which has none itself", () => {
  const gap = ground((_, column) => (column === MID ? 3 : column === MID + 2 ? Number.NaN : 0));
  const found = shadows(gap, { azimuthDeg: 270, elevationDeg: 45 });
  expect([1, 2, 3].map((step) => inShadow(found, MID, MID + step))).toEqual([1, 0, 1]);
});

test("at night everything that is known is dark", () => {
  const found = shadows(
    ground((row) => (row === 0 ? Number.NaN : 0)),
    { azimuthDeg: 0, elevationDeg: -3 },
  );
  expect([found[0], found.at(-1)]).toEqual([0, 1]);
});
