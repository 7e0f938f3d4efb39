/** The tab of annotations. */

import type { Shape } from "../../map/sketch";
import { h } from "../../page/dom";
import { time } from "../../page/format";
import type { AnnotationFeature, Edit } from "../../server/edits";
import { categoryOf } from "./categories";
import { type Deleted, deletedOf, historyList, openList } from "./history";
import type { Unsent } from "./outbox";

export interface NoteActions {
  readonly start: (shape: Shape) => void;
  readonly zoomTo: (id: string) => void;
  readonly edit: (note: AnnotationFeature) => void;
  readonly redraw: (note: AnnotationFeature) => void;
  readonly remove: (note: AnnotationFeature) => void;
  readonly restore: (deleted: Deleted) => void;
  readonly log: () => Promise<readonly Edit[]>;
  readonly send: () => void;
  readonly discard: (unsent: Unsent) => void;
}

const SHAPES: readonly (readonly [Shape, string])[] = [
  ["point", "Point"],
  ["line", "Line"],
  ["area", "Polygon"],
];

export function annotationsPanel(
  notes: readonly AnnotationFeature[],
  unsent: readonly Unsent[],
  mayWrite: boolean,
  actions: NoteActions,
): HTMLElement {
  const tools = SHAPES.map(([shape, name]) =>
    h(
      "button",
      {
        type: "button",
        class: "primary",
        "data-shape": shape,
        onclick: () => actions.start(shape),
      },
      name,
    ),
  );
  return h(
    "div",
    {},
    mayWrite
      ? h("div", { class: "actions" }, ...tools)
      : h("p", { class: "hint" }, "Sign in as an analyst to annotate the map."),
    unsent.length > 0 ? unsentList(unsent, actions) : null,
    notes.length > 0
      ? h("ul", { class: "plain" }, ...notes.map((note) => row(note, mayWrite, actions)))
      : h("p", { class: "hint" }, "There are no annotations."),
    openList("deleted", "Deleted annotations", async () => {
      const deleted = deletedOf(await actions.log());
      if (deleted.length === 0) return [h("li", {}, "None was deleted.")];
      return deleted.map((one) => deletedRow(one, mayWrite, actions));
    }),
  );
}

function deletedRow(deleted: Deleted, mayWrite: boolean, actions: NoteActions): HTMLElement {
  const { id, annotation, deletion } = deleted;
  const { author, at, note } = deletion;
  const by = `deleted by ${author} · ${time(at)} UTC${note ? ` · ${note}` : ""}`;
  return h(
    "li",
    { class: "note-row", "data-deleted": id },
    dot(annotation.category),
    h("span", {}, annotation.text),
    h("small", {}, by),
    mayWrite
      ? h(
          "div",
          { class: "note-acts" },
          link("Restore", () => actions.restore(deleted)),
        )
      : null,
    historyList(id, actions.log),
  );
}

const link = (name: string, run: () => void) =>
  h("button", { type: "button", class: "link", onclick: run }, name);

function dot(category: unknown): HTMLElement {
  const { colour, title } = categoryOf(category);
  return h("i", { class: "note-dot", style: `background:${colour}`, title });
}

function row(note: AnnotationFeature, mayWrite: boolean, actions: NoteActions): HTMLElement {
  const { id, properties } = note;
  const { category, state, text, author, at } = properties;
  const facts = [categoryOf(category).title, ...(state === "draft" ? ["draft"] : [])];
  return h(
    "li",
    { class: "note-row", "data-note": id, "data-state": state ?? "published" },
    dot(category),
    h("button", { type: "button", class: "link", onclick: () => actions.zoomTo(id) }, text),
    h("small", {}, `${facts.join(", ")} · ${author} · ${time(at)} UTC`),
    mayWrite
      ? h(
          "div",
          { class: "note-acts" },
          link("Edit", () => actions.edit(note)),
          link("Redraw", () => actions.redraw(note)),
          link("Delete", () => actions.remove(note)),
        )
      : null,
    historyList(Number(id), actions.log),
  );
}

function unsentList(unsent: readonly Unsent[], actions: NoteActions): HTMLElement {
  const rows = unsent.map((one) =>
    h(
      "li",
      { class: "note-row", "data-unsent": one.key },
      dot(one.annotation.category),
      h("span", {}, one.annotation.text),
      h(
        "div",
        { class: "note-acts" },
        link("Discard", () => actions.discard(one)),
      ),
    ),
  );
  return h(
    "section",
    { class: "unsent" },
    h("b", {}, "Not sent yet"),
    h("small", {}, "kept in this browser, and sent as soon as the server answers"),
    h("ul", { class: "plain" }, ...rows),
    h("button", { type: "button", class: "plain", onclick: () => actions.send() }, "Send now"),
  );
}
