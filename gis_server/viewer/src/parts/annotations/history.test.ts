import { expect, test } from "vitest";
import type { Edit } from "../../server/edits";
import { deletedOf, historyOf } from "./history";

const PLACE = { type: "Point", coordinates: [1, 2] };
const edit = (id: number, author: string, document: Edit["document"], note = ""): Edit => ({
  ...{ id, kind: "annotation", author, at: `2026-11-25T10:0${id}:00Z`, note },
  ...{ document, undoes: null, counts: true },
});

const LOG = [
  edit(1, "Ann", { text: "rock", geometry: PLACE, state: "draft", category: "note" }),
  edit(2, "Bob", { text: "another", geometry: PLACE }),
  edit(3, "Bob", { text: "a rock", geometry: PLACE, category: "target", replaces: 1 }, "seen"),
  edit(4, "Ann", {
    ...{ text: "a rock", category: "target", replaces: 3 },
    geometry: { type: "Point", coordinates: [1, 3] },
  }),
];

test("every version of an annotation is listed with its changes, the newest first", () => {
  expect(historyOf(LOG, 4).map(({ author, what }) => [author, what])).toEqual([
    ["Ann", "redrawn"],
    ["Bob", "text: a rock, category: Target, published (seen)"],
    ["Ann", "written: rock"],
  ]);
});

test("older annotations without category and state are published notes", () => {
  const log = [...LOG, edit(5, "Cid", { ...LOG[1]?.document, category: "note", replaces: 2 })];
  expect(historyOf(log, 5)[0]?.what).toBe("saved unchanged");
});

test("of what is not in the log there is no history", () => expect(historyOf(LOG, 9)).toEqual([]));

test("deleted annotations are listed with what deleted them, replaced, restored and moved ones are not", () => {
  const undo = (id: number, undoes: number, note = "", counts = true): Edit => ({
    ...edit(id, "Ann", {}, note),
    ...{ kind: "undo", undoes, counts },
  });
  const gone = (one: Edit): Edit => ({ ...one, counts: false });
  const [first, second, third, fourth] = LOG as [Edit, Edit, Edit, Edit];
  const log = [
    ...[gone(first), gone(second), undo(5, 1, "replaced"), gone(third), undo(6, 3, "replaced")],
    ...[gone(fourth), undo(7, 2), undo(8, 4, "a shadow")],
    ...[gone(edit(9, "Cid", { text: "moved" })), undo(10, 9, "moved to MER2-1")],
    ...[edit(11, "Cid", { text: "restored" }), undo(12, 11, "", false), undo(13, 12)],
  ];
  expect(deletedOf(log).map(({ id, deletion }) => [id, deletion.id])).toEqual([
    [4, 8],
    [2, 7],
  ]);
});
