import { expect, test } from "vitest";
import { rasterLayer, vectorLayer } from "../fixtures";
import { bandsOf, isBand, legendQuery, SOURCE_STOP } from "./bands";
import { ownStyle } from "./raster-style";

const model = (kind: string) => ({ ...rasterLayer("mer2", kind), values: "values/{z}", unit: "m" });

test("a terrain model has four bands that are layers of their own", () => {
  const bands = bandsOf(model("dtm"));
  expect(bands.map(({ kind }) => kind)).toEqual([
    "dtm-sigma",
    "dtm-pose",
    "dtm-observations",
    "dtm-class",
  ]);
  expect(bands.every(isBand)).toBe(true);
  expect(new Set(bands.map(({ id }) => id)).size).toBe(4);
  expect(bands.map(({ kind }) => ownStyle(kind)?.quantity)).toEqual([
    "sigma",
    "pose",
    "observations",
    "class",
  ]);
});

test("a merged model also has the stop that each cell is from, which its file names", () => {
  const source = bandsOf(model("region-dtm")).at(-1);
  expect(source).toMatchObject({ kind: SOURCE_STOP, values: null });
  expect(source?.tiles.endsWith("?style=source")).toBe(true);
  expect(legendQuery({ kind: SOURCE_STOP })).toBe("?style=source");
  expect(legendQuery({ kind: "dtm" })).toBeNull();
});

test("other layers have none", () => {
  expect(bandsOf(model("slope"))).toEqual([]);
  expect(bandsOf({ ...model("dtm"), values: null })).toEqual([]);
  expect(bandsOf(vectorLayer("mer2", "stops"))).toEqual([]);
  expect(isBand({ kind: "region-dtm" })).toBe(false);
});
