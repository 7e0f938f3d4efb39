import { expect, test } from "vitest";
import { rasterLayer, vectorLayer } from "../fixtures";
import { LayerList } from "./layer-list";

const STOP = "mer2-site0010-drive0064";
const hillshade = rasterLayer(STOP, "hillshade");
const slope = rasterLayer(STOP, "slope");
const stops = vectorLayer("mer2", "stops");

test("without a link layers are shown as they are at first", () => {
  const list = new LayerList([hillshade, slope, stops], null);
  expect([...list.on.keys()]).toEqual([hillshade.id, stops.id]);
});

test("a link names the layers that are on, and their opacity", () => {
  const list = new LayerList(
    [hillshade, slope, stops],
    new Map([[slope.id, { opacity: 0.3, style: null, blend: null }]]),
  );
  expect([...list.on]).toEqual([[slope.id, { opacity: 0.3, style: null, blend: null }]]);
});

test("changes are signalled, and only that layer changes", () => {
  const list = new LayerList([hillshade, slope], null);
  const emitted: string[] = [];
  list.changed.on(({ id }) => emitted.push(id));
  list.change(slope, { visible: true });
  expect(emitted).toEqual([slope.id]);
  expect(list.state(slope)).toEqual({ visible: true, opacity: 0.6, style: null, blend: null });
  expect(list.state(hillshade).visible).toBe(true);
});

test("layers that are published again keep how they are shown", () => {
  const list = new LayerList([hillshade, slope], null);
  list.change(hillshade, { visible: false });
  list.replace([{ ...hillshade, digest: "new" }, stops]);
  expect(list.state(hillshade).visible).toBe(false);
  expect(list.state(stops).visible).toBe(true);
  expect(list.all.map(({ digest }) => digest)).toContain("new");
});

test("the widest layers of a kind are those of the region where it has any", () => {
  const near = vectorLayer(STOP, "stops");
  expect(new LayerList([near, stops], null).widest("stops")).toEqual([stops]);
  expect(new LayerList([near], null).widest("stops")).toEqual([near]);
});

const ids = (layers: readonly { id: string }[]) => layers.map(({ id }) => id);

test("the uppermost layer is listed first, and layers change places with the next that is on", () => {
  const list = new LayerList([slope, hillshade, stops], null);
  list.change(slope, { visible: true });
  expect(ids(list.shown)).toEqual([stops.id, slope.id, hillshade.id]);
  list.move(slope, -1);
  expect(ids(list.shown)).toEqual([stops.id, hillshade.id, slope.id]);
  expect(list.height(slope)).toBeLessThan(list.height(hillshade));
  list.move(slope, -1);
  expect(ids(list.shown)).toEqual([stops.id, hillshade.id, slope.id]);
});

test("a layer that is dropped over another lies right over it", () => {
  const list = new LayerList([slope, hillshade, stops], null);
  list.change(slope, { visible: true });
  list.place(hillshade, stops, 1);
  expect(ids(list.shown)).toEqual([hillshade.id, stops.id, slope.id]);
});

test("a link keeps the order that was chosen by hand, and only that", () => {
  const on = new Map(
    [stops, slope, hillshade].map(({ id }) => [id, { opacity: 1, style: null, blend: null }]),
  );
  expect(ids(new LayerList([slope, hillshade, stops], on, true).shown)).toEqual([
    hillshade.id,
    slope.id,
    stops.id,
  ]);
  expect(ids(new LayerList([slope, hillshade, stops], on).shown)[0]).toBe(stops.id);
});

test("new products keep the order of layers", () => {
  const list = new LayerList([hillshade, stops], null);
  list.move(stops, -1);
  list.replace([hillshade, stops, slope]);
  expect(ids(list.shown)).toEqual([hillshade.id, stops.id]);
});

test("one layer alone, or those of one sol, are drawn", () => {
  const old = { ...hillshade, sols: [154] };
  const list = new LayerList([old, stops], null);
  expect([old, stops].map((layer) => list.isDrawn(layer, [155, 155]))).toEqual([false, true]);
  list.setSolo(old);
  expect([old, stops].map((layer) => list.isDrawn(layer, null))).toEqual([true, false]);
  list.change(old, { visible: false });
  expect(list.solo).toBeNull();
});

test("an earlier version lies right over the latest, looks like it, and goes away again", () => {
  const list = new LayerList([slope, hillshade, stops], null);
  list.change(hillshade, { opacity: 0.4 });
  const version = { ...hillshade, id: `${hillshade.id}@0123456789abcdef`, version: "sol 154" };
  list.addVersion(version);
  expect(list.all.map(({ id }) => id)).not.toContain(version.id);
  expect(list.state(version)).toEqual({ visible: false, opacity: 0.4, style: null, blend: null });
  list.change(version, { visible: true });
  expect(ids(list.shown)).toEqual([stops.id, version.id, hillshade.id]);
  list.replace([slope, hillshade, stops]);
  expect(ids(list.shown)).toEqual([stops.id, version.id, hillshade.id]);
  list.dismiss(version);
  expect(ids(list.shown)).toEqual([stops.id, hillshade.id]);
});

test("a version that a link has on is awaited until it is brought", () => {
  const id = `${hillshade.id}@0123456789abcdef`;
  const linked = new Map([[id, { opacity: 0.5, style: null, blend: null }]]);
  const list = new LayerList([hillshade], linked);
  expect(list.missing).toEqual([id]);
  list.addVersion({ ...hillshade, id });
  expect(list.missing).toEqual([]);
  expect(list.state({ id })).toEqual({ visible: true, opacity: 0.5, style: null, blend: null });
});

test("another link is followed: its layers are shown with its settings, all others are off", () => {
  const list = new LayerList([hillshade, slope, stops], null);
  const changed: string[] = [];
  list.changed.on(({ id }) => changed.push(id));
  list.follow(new Map([[slope.id, { opacity: 0.4, style: null, blend: null }]]), false);
  expect(list.shown.map(({ id }) => id)).toEqual([slope.id]);
  expect(list.state(slope).opacity).toBe(0.4);
  changed.length = 0;
  list.follow(new Map([[slope.id, { opacity: 0.4, style: null, blend: null }]]), false);
  expect(changed).toEqual([]);
});

test("a link that is followed brings its order, and a later one takes it back", () => {
  const list = new LayerList([hillshade, slope, stops], null);
  const plain = { opacity: 1, style: null, blend: null };
  list.follow(
    new Map([
      [stops.id, plain],
      [slope.id, plain],
    ]),
    true,
  );
  expect(list.shown.map(({ id }) => id)).toEqual([slope.id, stops.id]);
  list.follow(
    new Map([
      [slope.id, plain],
      [stops.id, plain],
    ]),
    false,
  );
  expect(list.shown.map(({ id }) => id)).toEqual([stops.id, slope.id]);
});
