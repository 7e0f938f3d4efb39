import { describe, expect, test } from "vitest";
import type { SceneCamera, SceneStop } from "../../server/scene";
import { headingDeg, middle, onMap, orbited, outline, pyramid, sunDirection } from "./geometry";

/** A rover that stands level and looks to the east: forward is east, right is south, down is down. */
const STOP: SceneStop = {
  stop: "mer2-site0010-drive0064",
  site: 10,
  drive: 64,
  sols: [155],
  held: false,
  place: [100, 50, 3],
  telemetry: [101, 50, 3],
  map_from_rover: [
    [1, 0, 0],
    [0, -1, 0],
    [0, 0, -1],
  ],
  ellipsoid: {
    semi_axes_m: [0.1, 0.1, 0.1],
    directions: [
      [1, 0, 0],
      [0, 1, 0],
      [0, 0, 1],
    ],
  },
};
const BODY = { back_m: 0.9, front_m: 0.8, half_width_m: 1.15, deck_m: 0.6, ground_m: 0.294 };

test("the sun in the east at 30 degrees", () => {
  const [east, north, up] = sunDirection(90, 30);
  expect(east).toBeCloseTo(Math.sqrt(3) / 2, 12);
  expect(north).toBeCloseTo(0, 12);
  expect(up).toBeCloseTo(0.5, 12);
});

describe("the rover", () => {
  test("a point ahead, to the right and above the deck", () => {
    expect(onMap(STOP, [2, 0.5, -1])).toEqual([102, 49.5, 4]);
    expect(headingDeg(STOP)).toBeCloseTo(90, 12);
  });

  test("its outline is as long and wide as it is", () => {
    const ring = outline(STOP, BODY);
    const easts = ring.map(([east]) => east);
    const norths = ring.map(([, north]) => north);
    expect(Math.min(...easts)).toBeCloseTo(99.1, 9);
    expect(Math.max(...norths) - Math.min(...norths)).toBeCloseTo(2.3, 9);
    expect(ring[0]).toEqual(ring.at(-1));
  });
});

test("a pyramid of sight has the given length along its axis", () => {
  const slant = Math.SQRT1_2;
  const camera: SceneCamera = {
    image: "A",
    stop: "S",
    sol: 1,
    instrument: "NAVCAM",
    eye: "left",
    partner: null,
    centre: [0, 0, 1.5],
    axis: [0, 1, 0],
    corners: [
      [-slant, slant, 0],
      [slant, slant, 0],
      [slant, slant, 0],
      [-slant, slant, 0],
    ],
  };
  const segments = pyramid(camera, 2);
  expect(segments).toHaveLength(16);
  expect(segments[1]?.map((value) => Number(value.toFixed(9)))).toEqual([-2, 2, 1.5]);
});

describe("orbiting", () => {
  test("keeps the distance and turns about the vertical", () => {
    const [x, y, z] = orbited([10, 0, 0], { azimuth: Math.PI / 2 });
    expect([x, y, z].map((value) => Number(value.toFixed(9)))).toEqual([0, 10, 0]);
  });
  test("never gets over the top", () => {
    const [x, y, z] = orbited([1, 0, 1], { elevation: 9 });
    expect(Math.atan2(z, Math.hypot(x, y))).toBeLessThan(Math.PI / 2);
  });
  test("comes nearer", () => {
    expect(Math.hypot(...orbited([3, 4, 0], { scale: 0.5 }))).toBeCloseTo(2.5, 12);
  });
});

test("the middle of two models", () => {
  const found = middle([
    { bounds: [0, 0, 10, 10], range: [1, 3] },
    { bounds: [10, -10, 20, 4], range: [-3, 1] },
  ]);
  expect(found.origin).toEqual([10, 0, 0]);
  expect(found.size).toBeCloseTo(Math.hypot(20, 20), 12);
  expect(middle([]).origin).toEqual([0, 0, 0]);
});
