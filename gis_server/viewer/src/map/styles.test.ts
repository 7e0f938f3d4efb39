import Feature from "ol/Feature";
import LineString from "ol/geom/LineString";
import Point from "ol/geom/Point";
import type Style from "ol/style/Style";
import { expect, test } from "vitest";
import { stopRows } from "../parts/traverse/stop-table";
import {
  ADJUSTED,
  type DrawingState,
  drawingOf,
  ellipseFactor,
  ellipseRing,
  TELEMETRY,
  UNPAIRED,
} from "./styles";

const STATE: DrawingState = { sols: null, ellipseFactor: 1, solsAt: new Map() };
const line = (properties: object) =>
  new Feature({
    geometry: new LineString([
      [0, 0],
      [1, 1],
    ]),
    ...properties,
  });
const stylesOf = (kind: string, feature: Feature, state = STATE): Style[] => {
  const drawn = drawingOf(kind, state)(feature, 1);
  return drawn ? [drawn].flat() : [];
};

test("telemetry is dashed blue and the adjusted traverse is red", () => {
  const telemetry = stylesOf("traverse", line({ solution: "telemetry" }))
    .at(-1)
    ?.getStroke();
  expect(telemetry?.getColor()).toBe(TELEMETRY);
  expect(telemetry?.getLineDash()).not.toBeNull();
  const adjusted = stylesOf("traverse", line({ solution: "adjusted" }))
    .at(-1)
    ?.getStroke();
  expect(adjusted?.getColor()).toBe(ADJUSTED);
  expect(adjusted?.getLineDash()).toBeNull();
});

test("the major axis of an ellipse points along its azimuth, clockwise from north", () => {
  const ring = ellipseRing([10, 20], 2, 1, 90);
  const first = ring[0];
  expect(first?.[0]).toBeCloseTo(12, 12); // azimuth 90 is east
  expect(first?.[1]).toBeCloseTo(20, 12);
  expect(ring[0]).toEqual(ring.at(-1));
  const north = Math.max(...ring.map(([, y]) => y));
  expect(north).toBeCloseTo(21, 9);
});

test("small ellipses are drawn larger and large ones as they are", () => {
  expect(ellipseFactor(0.01, 100)).toBe(500);
  expect(ellipseFactor(50, 100)).toBe(1);
  expect(ellipseFactor(0, 100)).toBe(1);
});

test("an image without partner is drawn otherwise", () => {
  const alone = line({ unpaired_because: "never sent", sol: 1 });
  expect(stylesOf("pointing", alone)[0]?.getStroke()?.getColor()).toBe(UNPAIRED);
  expect(
    stylesOf("pointing", line({ sol: 1 }))[0]
      ?.getStroke()
      ?.getColor(),
  ).not.toBe(UNPAIRED);
});

test("only the chosen sol's images are drawn", () => {
  const state: DrawingState = { ...STATE, sols: [156, 156] };
  expect(stylesOf("footprints", line({ sol: 155 }), state)).toHaveLength(0);
  expect(stylesOf("footprints", line({ sol: 156 }), state)).toHaveLength(1);
  expect(stylesOf("tie-points", line({ sols: [154, 155] }), state)).toHaveLength(0);
  expect(stylesOf("tie-points", line({ sols: [155, 156] }), state)).toHaveLength(1);
  expect(stylesOf("tie-points", line({}), state)).toHaveLength(1); // of an earlier version
});

test("index contours carry their elevation and the others do not", () => {
  const far = new LineString([
    [0, 0],
    [500, 0],
  ]);
  const labelOf = (is_index: boolean) =>
    stylesOf("contours", new Feature({ geometry: far, elevation_m: -1.5, is_index }))[1]
      ?.getText()
      ?.getText();
  expect(labelOf(true)).toBe("−1.5 m");
  expect(labelOf(false)).toBeUndefined();
});

test("telemetry and adjusted places of a stop become one row of the table", () => {
  const stop = (site: number, solution: string, east: number) =>
    new Feature({ geometry: new Point([east, 0]), stop: `s${site}`, site, drive: 0, solution });
  const rows = stopRows([
    stop(11, "adjusted", 5),
    stop(2, "adjusted", 1),
    stop(11, "telemetry", 7),
    stop(2, "telemetry", 1.5),
  ]);
  expect(rows.map(({ label }) => label)).toEqual(["2/0", "11/0"]);
  expect(rows[1]?.at).toEqual([5, 0]);
  expect(rows[1]?.telemetry).toEqual([7, 0]);
});
