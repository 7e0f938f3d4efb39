import { expect, test } from "vitest";
import type { TraverseRow } from "../../server/network";
import type { ImageEntry } from "../../server/records";
import { localTimes, positionText, telemetryError } from "./card";

const ROW = {
  horizontal_m: 3,
  sigma_horizontal_m: 0.03,
  distance_m: 3 / 0.175,
  place: [12.3456, -1.2345, 0.5],
  sigma_north_m: 0.014,
  sigma_east_m: 0.05,
  sigma_up_m: 0.1,
  percent: 17.5,
  offset_m: [3, 0, 4],
} as unknown as TraverseRow;
const image = (time: string | null) => ({ local_solar_time: time }) as unknown as ImageEntry;

test("the telemetry error is given on the map and in 3D", () => {
  expect(telemetryError(ROW)).toBe(
    "horizontal 3.00 ± 0.03 m (17.50 % of the way), 3D 5.00 ± 0.08 m",
  );
  expect(telemetryError({ ...ROW, percent: null, offset_m: [3, 0, null] })).toBe(
    "horizontal 3.00 ± 0.03 m",
  );
});

test("local time is that of the first and the last image", () => {
  expect(localTimes([image("14:30:32"), image(null), image("11:02:33")])).toBe("11:02 to 14:30");
  expect(localTimes([image("11:02:33")])).toBe("11:02");
  expect(localTimes([image(null)])).toBeNull();
});

test("a position has the digits that its standard deviations leave; one that is held has none", () => {
  expect(positionText(ROW)).toBe("N −1.234 ± 0.014 m, E 12.35 ± 0.05 m, 0.50 ± 0.10 m up");
  const held = { ...ROW, sigma_north_m: 0, sigma_east_m: 0, sigma_up_m: 0 };
  expect(positionText(held)).toBe("N −1.23 m, E 12.35 m, 0.50 m up");
});
