import { expect, test } from "vitest";
import { rasterLayer } from "../fixtures";
import { versionTitle } from "./versions";

const layer = rasterLayer("mer2", "dtm");
const of = (scope: string, is_overall = false) => [{ id: scope, scope, is_overall }];

test.each([
  [of("mer2-sol0156"), "sol 156 · 2026-11-21 01:02"],
  [of("mer2-sol0156-overall", true), "sol 156, overall · 2026-11-21 01:02"],
  [[], "2026-11-21 01:02"],
])("a version names its solution and when it was made", (solutions, title) =>
  expect(versionTitle({ layer, solutions, is_latest: false, run: null })).toBe(title),
);
