import { expect, test } from "vitest";
import { fitting } from "./grid";
import type { Column } from "./rows";

const COLUMNS: readonly Column[] = ["a", "b", "c", "d"].map((key) => ({
  key,
  title: key,
  width: 10,
}));
const shown = (roomPx: number, sort: string | null = null) =>
  fitting(COLUMNS, roomPx, sort)
    .map(({ key }) => key)
    .join("");

test("as many columns are shown as have room, and at least the first", () => {
  expect([400, 320, 240, 160, 40].map((room) => shown(room))).toEqual([
    "abcd",
    "abcd",
    "abc",
    "ab",
    "a",
  ]);
});

test("the column that rows are sorted by stays in view", () => {
  expect([shown(240, "d"), shown(160, "d"), shown(40, "d")]).toEqual(["abd", "ad", "ad"]);
});
