import { expect, test } from "vitest";
import { LinkBook } from "./kept";

test("a part gets the value of its key at once and when another link is followed", () => {
  const link = new LinkBook(new Map([["sun", "noon"]]));
  const received: (string | null)[] = [];
  link.follow("sun", (text) => received.push(text));
  link.restore(new Map([["sun", "noon"]]));
  link.restore(new Map([["sun", "dusk"]]));
  link.restore(new Map());
  expect(received).toEqual(["noon", "dusk", null]);
});

test("a part is not called for what it writes itself", () => {
  const link = new LinkBook(new Map());
  const received: (string | null)[] = [];
  link.follow("sun", (text) => received.push(text));
  link.write("sun", "noon");
  link.restore(new Map([["sun", "noon"]]));
  expect(received).toEqual([]);
});

test("keys that nobody reads are unknown", () => {
  const link = new LinkBook(
    new Map([
      ["sun", "noon"],
      ["zoom", "3"],
    ]),
  );
  link.read("sun");
  expect(link.unknown).toEqual(["zoom"]);
});
