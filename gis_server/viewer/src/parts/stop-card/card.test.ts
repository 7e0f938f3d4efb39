import { expect, test } from "vitest";
import type { TraverseRow } from "../../server/network";
import type { ImageEntry } from "../../server/records";
import { localTimes, telemetryError } from "./card";

const ROW = {
  horizontal_m: 3,
  percent: 17.5,
  offset_m: [3, 0, 4],
} as unknown as TraverseRow;
const image = (time: string | null) => ({ local_solar_time: time }) as unknown as ImageEntry;

test("the telemetry error is given on the map and in 3D", () => {
  expect(telemetryError(ROW)).toBe("horizontal 3.000 m (17.50 % of the way), 3D 5.000 m");
  expect(telemetryError({ ...ROW, percent: null, offset_m: [3, 0, null] })).toBe(
    "horizontal 3.000 m",
  );
});

test("local time is that of the first and the last image", () => {
  expect(localTimes([image("14:30:32"), image(null), image("11:02:33")])).toBe("11:02 to 14:30");
  expect(localTimes([image("11:02:33")])).toBe("11:02");
  expect(localTimes([image(null)])).toBeNull();
});
