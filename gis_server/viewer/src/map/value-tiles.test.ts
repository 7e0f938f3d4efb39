import { afterEach, expect, test, vi } from "vitest";
import { pen } from "./painting";
import { difference, quantityOf } from "./shading";
import { spread } from "./stretch";
import { decode, SIDE, STRIDE, TileFormatError, ValueTile, ValueTiles } from "./value-tiles";

afterEach(() => vi.unstubAllGlobals());

/** A tile as the server writes it: 16 bits a value, differences along the row, low bytes before high ones. */
function encode(rows: readonly (readonly number[])[], offset: number, step: number): ArrayBuffer {
  const columns = rows[0]?.length ?? 0;
  const count = rows.length * columns;
  const body = new ArrayBuffer(24 + 2 * count);
  const head = new DataView(body);
  new Uint8Array(body).set(new TextEncoder().encode("SMV1"));
  head.setUint16(4, columns, true);
  head.setUint16(6, rows.length, true);
  head.setFloat64(8, offset, true);
  head.setFloat64(16, step, true);
  rows.forEach((row, r) =>
    row.forEach((k, c) => {
      const change = (k - (c ? (row[c - 1] ?? 0) : 0)) & 0xffff;
      head.setUint8(24 + r * columns + c, change & 0xff);
      head.setUint8(24 + count + r * columns + c, change >> 8);
    }),
  );
  return body;
}

/** A plane that rises by `east` and `north` a metre, on cells of 0.5 m. */
function plane(east: number, north: number): ValueTile {
  const values = new Float32Array(STRIDE * STRIDE);
  for (let row = 0; row < STRIDE; row += 1)
    for (let column = 0; column < STRIDE; column += 1)
      values[row * STRIDE + column] = 0.5 * (east * column - north * row);
  return new ValueTile(values, 0.5);
}

test("values are differences along their row, and 0 is not measured", () => {
  const rows = [
    [1, 300, 0, 65535],
    [5, 4, 3, 0],
  ];
  expect([...decode(encode(rows, 10, 0.25))]).toEqual([
    10.25,
    85,
    Number.NaN,
    10 + 65535 * 0.25,
    11.25,
    11,
    10.75,
    Number.NaN,
  ]);
});

test("data that is not a tile of values is refused by its first bytes", () => {
  expect(() => decode(new ArrayBuffer(30))).toThrow(TileFormatError);
  expect(() => decode(new ArrayBuffer(3))).toThrow(/SMV1/);
});

test("the slope of a plane is that of the plane, everywhere to the edge", () => {
  const slope = quantityOf(plane(0.3, 0.4), "slope", { azimuthDeg: 0, elevationDeg: 45 });
  expect(slope).toHaveLength(SIDE * SIDE);
  const steep = (Math.atan(0.5) * 180) / Math.PI;
  expect(Math.min(...slope.slice(0, 999), ...slope.slice(-999))).toBeCloseTo(steep, 3);
  expect(slope.every((value) => Math.abs(value - steep) < 0.01)).toBe(true);
});

test("ground that falls to the north tilts north, and its aspect is north", () => {
  const sun = { azimuthDeg: 0, elevationDeg: 30 };
  expect(quantityOf(plane(0, -1), "tilt", sun)[500]).toBeCloseTo(45, 3);
  expect(quantityOf(plane(0, 1), "tilt", sun)[500]).toBeCloseTo(-45, 3);
  expect(quantityOf(plane(-1, 0), "aspect", sun)[500]).toBeCloseTo(90, 3);
  expect(quantityOf(plane(1, 1), "aspect", sun)[500]).toBeCloseTo(225, 3);
});

test("ground that faces the sun is bright, and ground that looks away is dark", () => {
  const sun = { azimuthDeg: 90, elevationDeg: 45 };
  expect(quantityOf(plane(-1, 0), "relief", sun)[0]).toBeCloseTo(1, 5);
  expect(quantityOf(plane(0, 0), "relief", sun)[0]).toBeCloseTo(Math.SQRT1_2, 5);
  expect(quantityOf(plane(2, 0), "relief", sun)[0]).toBe(0);
});

test("one unknown cell makes its neighbours' gradients unknown, and no others", () => {
  const tile = plane(0.1, 0);
  tile.values[10 * STRIDE + 10] = Number.NaN;
  const slope = quantityOf(tile, "slope", { azimuthDeg: 0, elevationDeg: 45 });
  expect(slope.filter(Number.isNaN)).toHaveLength(9);
  expect(
    quantityOf(tile, "value", { azimuthDeg: 0, elevationDeg: 45 }).filter(Number.isNaN),
  ).toHaveLength(1);
});

test("the difference of two planes is the difference of their heights", () => {
  const [a, b] = [plane(1, 0), plane(0.5, 0)];
  const found = difference(a, b);
  expect(found[0]).toBeCloseTo(a.at(0, 0) - b.at(0, 0), 6);
  expect(found[255]).toBeCloseTo(0.25 * 256, 4);
});

test("pixels have the colours of their values; nothing is drawn of what is unknown or low", () => {
  const draw = pen({ colours: ["#000000", "#ffffff"], low: 0, high: 10, floor: 2, unit: "" });
  const pixels = draw(Float32Array.of(Number.NaN, 1, 2, 5, 50));
  expect([...pixels.slice(0, 8)]).toEqual([0, 0, 0, 0, 0, 0, 0, 0]);
  expect([...pixels.slice(8, 12)]).toEqual([51, 51, 51, 255]);
  expect([...pixels.slice(16, 20)]).toEqual([255, 255, 255, 255]);
});

test("a tile is requested once, and one without values is remembered", async () => {
  let loading = 0;
  vi.stubGlobal("fetch", async () => {
    loading += 1;
    return new Response(null, { status: 204 });
  });
  const tiles = new ValueTiles(2);
  expect(await tiles.get("/a", 1)).toBeNull();
  expect(await tiles.get("/a", 1)).toBeNull();
  expect([loading, tiles.peek("/a")]).toEqual([1, null]);
  await tiles.get("/b", 1);
  await tiles.get("/c", 1);
  expect(tiles.peek("/a")).toBeUndefined();
});

test("a stretch leaves out the outermost fiftieth on both sides", () => {
  const values = Array.from({ length: 101 }, (_, k) => k);
  expect(spread([...values, Number.NaN])).toEqual([2, 98]);
  expect(spread([Number.NaN])).toBeNull();
  expect(spread([3, 3, 3])).toBeNull();
});
