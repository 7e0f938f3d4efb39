import { expect, test } from "vitest";
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

test("a stop is found by site and drive, as labels write it and as people say it", () => {
  expect(titles("10/64")).toEqual(["Site 10 · drive 64"]);
  expect(titles("  Site  10  drive 64 ")).toEqual(["Site 10 · drive 64"]);
  expect(titles("site 1")).toEqual([
    "Site 10",
    "Site 11",
    "Site 10 · drive 64",
    "Site 11 · drive 0",
  ]);
});

test("an image is found by any part of its name, however it is written", () => {
  expect(titles("2n156")).toEqual(["2N156000000EFF1000P1500L0M1"]);
  expect(titles("EFF1000P1500l")).toHaveLength(2);
});

test("two numbers are a place", () => {
  expect(find(ENTRIES, "12.5, -3")[0]?.goal).toEqual({ to: "place", point: [12.5, -3] });
  expect(find(ENTRIES, "12.5")).toEqual([]);
});

test("nothing finds nothing, and no list is endless", () => {
  expect(titles("  ")).toEqual([]);
  expect(titles("opportunity")).toEqual([]);
  expect(find(ENTRIES, "1", 2)).toHaveLength(2);
});
