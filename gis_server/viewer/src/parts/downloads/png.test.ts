import { deflateSync } from "node:zlib";
import { expect, test } from "vitest";
import { rasterLayer, vectorLayer } from "../../fixtures";
import { clipUrl } from "../../server/downloads";
import { crc32, withDensity } from "./png";
import { roundScale, sheetOf } from "../../sheet/sheet";

const text = (value: string) => new TextEncoder().encode(value);

test("the check value is that of every textbook", () => {
  expect(crc32(text("123456789"))).toBe(0xcbf43926);
  expect(crc32(text("IEND"))).toBe(0xae426082);
});

test("the density follows the header, and the rest is unchanged", () => {
  const png = Uint8Array.from([
    ...text("\x89PNG1234"),
    ...new Array(25).fill(7),
    ...deflateSync("x"),
  ]);
  const dense = withDensity(png, 300);
  const view = new DataView(dense.buffer);
  expect(dense.length).toBe(png.length + 21);
  expect(new TextDecoder().decode(dense.subarray(37, 41))).toBe("pHYs");
  expect(view.getUint32(41)).toBe(11811); // 300 dots an inch in dots a metre
  expect(view.getUint32(50)).toBe(crc32(dense.subarray(37, 50)));
  expect(dense.subarray(54)).toEqual(png.subarray(33));
});

test("at 1 : 200 and 300 dots an inch a dot is 17 mm of ground", () => {
  const sheet = sheetOf("a4", 300, 200, [664, 732], 0.1);
  expect(sheet.resolution).toBeCloseTo(0.016933, 5);
  expect([sheet.width, sheet.height]).toEqual([3272, 2126]);
});

test("an image of the screen keeps its dots, and states its scale", () => {
  const sheet = sheetOf("screen", 300, 200, [664, 732], 0.1);
  expect([sheet.width, sheet.height, sheet.resolution]).toEqual([664, 732, 0.1]);
  expect(sheet.scale).toBeCloseTo(378, 0);
});

test("more than a browser draws is refused", () => {
  expect(() => sheetOf("a3", 1200, 200, [1, 1], 1)).toThrow(/fewer dots/);
});

test.each([
  [378, 500],
  [200, 200],
  [210, 250],
  [1001, 1000],
  [6000, 10000],
])("1 : %d is drawn at 1 : %d", (scale, round) => expect(roundScale(scale)).toBe(round));

test("a part of a layer is requested by its box", () => {
  const box = [-1.23456, 0, 10, 20.5] as const;
  expect(clipUrl(rasterLayer("mer2", "dtm"), box)).toBe("/download/a/clip?bbox=-1.235,0,10,20.5");
  expect(clipUrl(vectorLayer("mer2", "stops"), box, "gpkg")).toMatch(/&f=gpkg$/);
});
