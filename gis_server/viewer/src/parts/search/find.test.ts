import { expect, test } from "vitest";
import { MISSION } from "../../fixtures";
import { localMap } from "../../map/projection";
import { entriesOf, find } from "./find";

const STOPS = [
  { stop: "mer2-site0010-drive0064", site: 10, drive: 64 },
  { stop: "mer2-site0011-drive0000", site: 11, drive: 0 },
];
const IMAGES = [
  { id: "2N156000000EFF1000P1500L0M1", sol: 156, instrument: "NAVCAM", ...STOPS[0] },
  { id: "2P155000000EFF1000P1500L0M1", sol: 155, instrument: "PANCAM", ...STOPS[1] },
] as never[];
const ENTRIES = entriesOf([155, 156, 1], STOPS, IMAGES);
const titles = (text: string) => find(ENTRIES, text).map(({ title }) => title);

test("a sol is found by its number, before the images that have it in their names", () => {
  expect(titles("156")).toEqual(["Sol 156", "2N156000000EFF1000P1500L0M1"]);
  expect(titles("sol 1")).toEqual(["Sol 1", "Sol 155", "Sol 156"]);
});

test("a stop is found by site and drive, as labels and people write it", () => {
  expect(titles("10/64")).toEqual(["Site 10 · drive 64"]);
  expect(titles("  Site  10  drive 64 ")).toEqual(["Site 10 · drive 64"]);
  expect(titles("site 1")).toEqual([
    "Site 10",
    "Site 11",
    "Site 10 · drive 64",
    "Site 11 · drive 0",
  ]);
});

test("an image is found by any part of its name, in upper or lower case", () => {
  expect(titles("2n156")).toEqual(["2N156000000EFF1000P1500L0M1"]);
  expect(titles("EFF1000P1500l")).toHaveLength(2);
});

test("two numbers are a place", () => {
  expect(find(ENTRIES, "12.5, -3")[0]?.goal).toEqual({ to: "place", point: [12.5, -3] });
  expect(find(ENTRIES, "12.5")).toEqual([]);
});

test("latitude and longitude are a place on the map of a mission", () => {
  const to = { local: localMap(MISSION), bounds: MISSION.bounds, frames: null };
  for (const text of ["-14.5689 175.4730", "14.5689S 175.473E", "S14°34'8.04\" E175°28'22.8\""]) {
    const [found] = find(ENTRIES, text, 40, to);
    if (found?.goal.to !== "place") throw new Error(`${text} is not a place`);
    const [east, north] = found.goal.point;
    expect(east).toBeCloseTo(5.74, 1);
    expect(north).toBeCloseTo(17.78, 1);
  }
});

test("nothing finds nothing, and no list is endless", () => {
  expect(titles("  ")).toEqual([]);
  expect(titles("opportunity")).toEqual([]);
  expect(find(ENTRIES, "1", 2)).toHaveLength(2);
});
