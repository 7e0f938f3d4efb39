import { expect, test } from "vitest";
import { cellText, choicesOf, type Column, listed, type Row, tableCsv } from "./rows";
import { ALL_ROWS } from "../../session/state";

const row = (id: string, values: Row["values"]): Row => ({ id, values, geometry: null });
const ROWS = [
  row("a", { name: "2N9", sol: 156, eye: "left", north: 1.23456, sigma: 0.05 }),
  row("b", { name: "2N10", sol: 155, eye: "right", north: null, sigma: null }),
  row("c", { name: "2N11", sol: 155, eye: "left", north: -2.3456, sigma: 0 }),
];
const NORTH: Column = { key: "north", title: "north", sigma: "sigma", resolution: 0.01, width: 9 };
const NAME: Column = { key: "name", title: "name, or so", width: 9 };
const ids = (query: Partial<typeof ALL_ROWS>) =>
  listed(ROWS, { ...ALL_ROWS, ...query }).map(({ id }) => id);

test("numbers in names are sorted as numbers, and what is not known comes last", () => {
  expect(ids({ sort: "name" })).toEqual(["a", "b", "c"]);
  expect(ids({ sort: "north" })).toEqual(["c", "a", "b"]);
  expect(ids({ sort: "north", isDescending: true })).toEqual(["a", "c", "b"]);
});

test("rows have all words and the chosen values", () => {
  expect(ids({ words: "LEFT 155" })).toEqual(["c"]);
  expect(ids({ choices: new Map([["sol", "155"]]) })).toEqual(["b", "c"]);
  expect(choicesOf(ROWS, { ...NAME, key: "sol" })).toEqual(["155", "156"]);
});

test("a value has the digits that its standard deviation leaves", () => {
  expect(ROWS.map((one) => cellText(one, NORTH))).toEqual(["1.23 ± 0.05", "–", "−2.35"]);
});

test("a file has all digits, and standard deviations in columns of their own", () => {
  expect(tableCsv(ROWS.slice(0, 2), [NAME, NORTH])).toBe(
    "name,north,sigma\n2N9,1.23456,0.05\n2N10,,\n",
  );
});
