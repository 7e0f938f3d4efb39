import { expect, test } from "vitest";
import type { AnnotationEdit } from "../../server/edits";
import { Outbox } from "./outbox";

class FakeStorage {
  readonly kept = new Map<string, string>();
  getItem(key: string): string | null {
    return this.kept.get(key) ?? null;
  }
  setItem(key: string, value: string): void {
    this.kept.set(key, value);
  }
}

const NOTE: AnnotationEdit = {
  geometry: { type: "Point", coordinates: [1, 2] },
  text: "layered rock",
  category: "target",
  state: "draft",
};

test("what was not sent is there after the page was closed, by mission", () => {
  const storage = new FakeStorage();
  const one = new Outbox("MER2", storage).add(NOTE);
  new Outbox("MER2", storage).add({ ...NOTE, text: "dune" });
  const [first, second] = new Outbox("MER2", storage).all;
  expect(first).toEqual(one);
  expect(second?.annotation.text).toBe("dune");
  expect(new Outbox("MER1", storage).all).toEqual([]);
});

test("what was sent is gone, the rest stays", () => {
  const outbox = new Outbox("MER2", new FakeStorage());
  const [one, other] = [outbox.add(NOTE), outbox.add(NOTE)];
  outbox.remove(one);
  expect(outbox.all).toEqual([other]);
});

test("what something else wrote there is no annotation", () => {
  const storage = new FakeStorage();
  storage.setItem("solmap-unsent-MER2", "{");
  expect(new Outbox("MER2", storage).all).toEqual([]);
});
