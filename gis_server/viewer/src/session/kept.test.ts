import { expect, test } from "vitest";
import { LinkBook } from "./kept";

test("a part is told what the link says under its key, at once and when another is followed", () => {
  const link = new LinkBook(new Map([["sun", "noon"]]));
  const told: (string | null)[] = [];
  link.follow("sun", (text) => told.push(text));
  link.restore(new Map([["sun", "noon"]]));
  link.restore(new Map([["sun", "dusk"]]));
  link.restore(new Map());
  expect(told).toEqual(["noon", "dusk", null]);
});

test("what a part writes itself is not told to it", () => {
  const link = new LinkBook(new Map());
  const told: (string | null)[] = [];
  link.follow("sun", (text) => told.push(text));
  link.write("sun", "noon");
  link.restore(new Map([["sun", "noon"]]));
  expect(told).toEqual([]);
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
