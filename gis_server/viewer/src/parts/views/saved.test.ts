import { expect, test } from "vitest";
import { formatViews, freeName, merged, parseViews, SavedViews } from "./saved";

const crater = { name: "crater", link: "#m=mer2&at=1,2,0.05" };

test("a file gives back the views that were written to it", () => {
  expect(parseViews(formatViews([crater]))).toEqual([crater]);
});

test.each([
  ["views", "not JSON"],
  ["null", "no saved views"],
  ['{"type":"FeatureCollection"}', "no saved views"],
  ['{"format":"solmap-views","version":2,"views":[]}', "Version 2"],
  ['{"format":"solmap-views","version":1,"views":[{"name":"a"}]}', "no link"],
  ['{"format":"solmap-views","version":1,"views":[{"name":"a","link":"https://a"}]}', "no link"],
])("the file %s is refused with the reason", (text, reason) => {
  expect(() => parseViews(text)).toThrow(reason);
});

test("a name that is taken is numbered", () => {
  const views = [crater, { ...crater, name: "crater (2)" }];
  expect(freeName("crater", views)).toBe("crater (3)");
  expect(freeName("dune", views)).toBe("dune");
});

test("a file read twice adds nothing, and another view of a known name is kept beside it", () => {
  const other = { name: "crater", link: "#m=mer2&at=9,9,1" };
  const once = merged([crater], [crater, other]);
  expect(once).toEqual([crater, { ...other, name: "crater (2)" }]);
});

test("what something else wrote into the browser counts as no views", () => {
  const kept = new Map([["solmap-views", "[1]"]]);
  const storage = {
    getItem: (key: string) => kept.get(key) ?? null,
    setItem: (key: string, text: string) => void kept.set(key, text),
  };
  const views = new SavedViews(storage);
  expect(views.all).toEqual([]);
  views.keep((all) => [...all, crater]);
  expect(new SavedViews(storage).all).toEqual([crater]);
});
