import { expect, test } from "vitest";
import { rasterLayer, vectorLayer } from "../fixtures";
import { LayerBook } from "./layer-book";

const STOP = "mer2-site0010-drive0064";
const hillshade = rasterLayer(STOP, "hillshade");
const slope = rasterLayer(STOP, "slope");
const stops = vectorLayer("mer2", "stops");

test("without a link layers are shown as they are at first", () => {
  const book = new LayerBook([hillshade, slope, stops], null);
  expect([...book.on.keys()]).toEqual([hillshade.id, stops.id]);
});

test("a link says what is on, and how strongly", () => {
  const book = new LayerBook([hillshade, slope, stops], new Map([[slope.id, 0.3]]));
  expect([...book.on]).toEqual([[slope.id, 0.3]]);
});

test("what changes is told, and only that layer changes", () => {
  const book = new LayerBook([hillshade, slope], null);
  const told: string[] = [];
  book.changed.on(({ id }) => told.push(id));
  book.change(slope, { visible: true });
  expect(told).toEqual([slope.id]);
  expect(book.state(slope)).toEqual({ visible: true, opacity: 0.6 });
  expect(book.state(hillshade).visible).toBe(true);
});

test("layers that are published anew keep how they are shown", () => {
  const book = new LayerBook([hillshade, slope], null);
  book.change(hillshade, { visible: false });
  book.replace([{ ...hillshade, digest: "new" }, stops]);
  expect(book.state(hillshade).visible).toBe(false);
  expect(book.state(stops).visible).toBe(true);
  expect(book.all.map(({ digest }) => digest)).toContain("new");
});

test("the widest layers of a kind are those of the region where it has any", () => {
  const near = vectorLayer(STOP, "stops");
  expect(new LayerBook([near, stops], null).widest("stops")).toEqual([stops]);
  expect(new LayerBook([near], null).widest("stops")).toEqual([near]);
});
