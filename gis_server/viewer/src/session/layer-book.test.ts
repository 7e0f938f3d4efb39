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

test("a link names the layers that are on, and their opacity", () => {
  const book = new LayerBook(
    [hillshade, slope, stops],
    new Map([[slope.id, { opacity: 0.3, style: null, blend: null }]]),
  );
  expect([...book.on]).toEqual([[slope.id, { opacity: 0.3, style: null, blend: null }]]);
});

test("changes are signalled, and only that layer changes", () => {
  const book = new LayerBook([hillshade, slope], null);
  const emitted: string[] = [];
  book.changed.on(({ id }) => emitted.push(id));
  book.change(slope, { visible: true });
  expect(emitted).toEqual([slope.id]);
  expect(book.state(slope)).toEqual({ visible: true, opacity: 0.6, style: null, blend: null });
  expect(book.state(hillshade).visible).toBe(true);
});

test("layers that are published again keep how they are shown", () => {
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

const ids = (layers: readonly { id: string }[]) => layers.map(({ id }) => id);

test("the uppermost layer is listed first, and layers change places with the next that is on", () => {
  const book = new LayerBook([slope, hillshade, stops], null);
  book.change(slope, { visible: true });
  expect(ids(book.shown)).toEqual([stops.id, slope.id, hillshade.id]);
  book.move(slope, -1);
  expect(ids(book.shown)).toEqual([stops.id, hillshade.id, slope.id]);
  expect(book.height(slope)).toBeLessThan(book.height(hillshade));
  book.move(slope, -1);
  expect(ids(book.shown)).toEqual([stops.id, hillshade.id, slope.id]);
});

test("a layer that is dropped over another lies right over it", () => {
  const book = new LayerBook([slope, hillshade, stops], null);
  book.change(slope, { visible: true });
  book.place(hillshade, stops, 1);
  expect(ids(book.shown)).toEqual([hillshade.id, stops.id, slope.id]);
});

test("a link keeps the order that was chosen by hand, and only that", () => {
  const on = new Map(
    [stops, slope, hillshade].map(({ id }) => [id, { opacity: 1, style: null, blend: null }]),
  );
  expect(ids(new LayerBook([slope, hillshade, stops], on, true).shown)).toEqual([
    hillshade.id,
    slope.id,
    stops.id,
  ]);
  expect(ids(new LayerBook([slope, hillshade, stops], on).shown)[0]).toBe(stops.id);
});

test("new products keep the order of layers", () => {
  const book = new LayerBook([hillshade, stops], null);
  book.move(stops, -1);
  book.replace([hillshade, stops, slope]);
  expect(ids(book.shown)).toEqual([hillshade.id, stops.id]);
});

test("one layer alone, or those of one sol, are drawn", () => {
  const old = { ...hillshade, sols: [154] };
  const book = new LayerBook([old, stops], null);
  expect([old, stops].map((layer) => book.isDrawn(layer, [155, 155]))).toEqual([false, true]);
  book.setSolo(old);
  expect([old, stops].map((layer) => book.isDrawn(layer, null))).toEqual([true, false]);
  book.change(old, { visible: false });
  expect(book.solo).toBeNull();
});

test("an earlier version lies right over the latest, looks like it, and goes away again", () => {
  const book = new LayerBook([slope, hillshade, stops], null);
  book.change(hillshade, { opacity: 0.4 });
  const version = { ...hillshade, id: `${hillshade.id}@0123456789abcdef`, version: "sol 154" };
  book.bring(version);
  expect(book.all.map(({ id }) => id)).not.toContain(version.id);
  expect(book.state(version)).toEqual({ visible: false, opacity: 0.4, style: null, blend: null });
  book.change(version, { visible: true });
  expect(ids(book.shown)).toEqual([stops.id, version.id, hillshade.id]);
  book.replace([slope, hillshade, stops]);
  expect(ids(book.shown)).toEqual([stops.id, version.id, hillshade.id]);
  book.dismiss(version);
  expect(ids(book.shown)).toEqual([stops.id, hillshade.id]);
});

test("a version that a link has on is awaited until it is brought", () => {
  const id = `${hillshade.id}@0123456789abcdef`;
  const linked = new Map([[id, { opacity: 0.5, style: null, blend: null }]]);
  const book = new LayerBook([hillshade], linked);
  expect(book.awaited).toEqual([id]);
  book.bring({ ...hillshade, id });
  expect(book.awaited).toEqual([]);
  expect(book.state({ id })).toEqual({ visible: true, opacity: 0.5, style: null, blend: null });
});

test("another link is followed: its layers are shown with its settings, all others are off", () => {
  const book = new LayerBook([hillshade, slope, stops], null);
  const changed: string[] = [];
  book.changed.on(({ id }) => changed.push(id));
  book.follow(new Map([[slope.id, { opacity: 0.4, style: null, blend: null }]]), false);
  expect(book.shown.map(({ id }) => id)).toEqual([slope.id]);
  expect(book.state(slope).opacity).toBe(0.4);
  changed.length = 0;
  book.follow(new Map([[slope.id, { opacity: 0.4, style: null, blend: null }]]), false);
  expect(changed).toEqual([]);
});

test("a link that is followed brings its order, and a later one takes it back", () => {
  const book = new LayerBook([hillshade, slope, stops], null);
  const plain = { opacity: 1, style: null, blend: null };
  book.follow(
    new Map([
      [stops.id, plain],
      [slope.id, plain],
    ]),
    true,
  );
  expect(book.shown.map(({ id }) => id)).toEqual([slope.id, stops.id]);
  book.follow(
    new Map([
      [slope.id, plain],
      [stops.id, plain],
    ]),
    false,
  );
  expect(book.shown.map(({ id }) => id)).toEqual([stops.id, slope.id]);
});
