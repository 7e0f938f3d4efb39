import { expect, test } from "vitest";
import type { Key } from "./state";
import { Store } from "./store";

test("listeners of a field hear of its changes, and of no others", () => {
  const store = new Store("#tab=sun");
  const heard: unknown[] = [];
  const stop = store.on("tab", (tab) => heard.push(tab));
  store.set("pt", [1, 2]);
  store.set("tab", "sun");
  store.set("tab", "notes");
  stop();
  store.set("tab", "runs");
  expect(heard).toEqual(["notes"]);
  expect(store.link).toBe("#tab=runs&pt=1,2");
});

test("who follows a field is not called for what it writes itself", () => {
  const store = new Store("#pt=1,2");
  const [mine, others]: [unknown[], unknown[]] = [[], []];
  store.on("pt", (point) => others.push(point));
  const write = store.follow("pt", (point) => mine.push(point));
  write([3, 4]);
  store.set("pt", null);
  expect(mine).toEqual([[1, 2], null]);
  expect(others).toEqual([[3, 4], null]);
});

test("another link changes the fields that differ, when all of them have their values", () => {
  const store = new Store("#tab=sun&pt=1,2&sol=5");
  const heard: [Key, unknown][] = [];
  store.changed.on((key) => heard.push([key, store.get("sol")]));
  store.restore("#tab=sun&pt=3,4&sol=6&zoom=2");
  expect(heard).toEqual([
    ["sol", [6, 6]],
    ["pt", [6, 6]],
  ]);
  expect(store.unknown).toEqual(["zoom"]);
  store.restore("#");
  expect([store.get("tab"), store.get("pt"), store.get("sol")]).toEqual(["point", null, null]);
});

test("the link to the same with another value leaves the state as it is", () => {
  const store = new Store("#tab=sun");
  expect(store.linkWith({ tab: "notes" })).toBe("#tab=notes");
  expect(store.link).toBe("#tab=sun");
});
