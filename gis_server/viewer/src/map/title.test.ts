import { expect, test } from "vitest";
import { titleOf } from "./title";

const MISSION = {
  title: "Spirit",
  landing: {
    ...{ name: "Columbia Memorial Station", origin: "", source: "a test" },
    ...{ longitude: 175, latitude: -14, radius_m: 3_393_000 },
  },
};
const layer = (scope: string, ...sols: number[]) => ({ scope, sols });
const LAYERS = [
  layer("mer2", 155, 156),
  layer("mer2-site0010-drive0064", 155),
  layer("mer2-site0011-drive0000", 156),
];
const parts = (...[layers, range]: [typeof LAYERS, [number, number] | null]) =>
  titleOf(MISSION, layers, range).parts.join(" ");

test("a map is of the sols and sites of its layers", () => {
  expect(titleOf(MISSION, LAYERS, null)).toEqual({
    title: "Spirit",
    parts: ["sols 155–156", "sites 10–11", "Columbia Memorial Station"],
  });
});

test("chosen sols leave their sites", () =>
  expect(parts(LAYERS, [156, 156])).toBe("sol 156 site 11 Columbia Memorial Station"));

test("layers of no site and no sol leave the landing site", () =>
  expect(parts([layer("mer2")], null)).toBe("all sols Columbia Memorial Station"));
