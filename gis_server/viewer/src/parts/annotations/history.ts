/** History of an annotation: its author, and the author, time and fields of each change. */

import { h } from "../../page/dom";
import { time } from "../../page/format";
import type { AnnotationEdit, Edit } from "../../server/edits";
import { categoryOf } from "./categories";

export interface Change {
  readonly author: string;
  /** UTC, ISO 8601. */
  readonly at: string;
  readonly what: string;
}

/** Of the annotation that an edit of the log wrote, the newest change first. */
export function historyOf(log: readonly Edit[], id: number): readonly Change[] {
  const edits = new Map(log.map((edit) => [edit.id, edit]));
  const changes: Change[] = [];
  for (let edit = edits.get(id); edit; ) {
    const { author, at, note } = edit;
    const now = edit.document as Partial<AnnotationEdit>;
    const before = edits.get(now.replaces ?? 0);
    const what = before ? differences(before.document, now) : `written: ${now.text}`;
    changes.push({ author, at, what: note ? `${what} (${note})` : what });
    edit = before;
  }
  return changes;
}

function differences(before: Partial<AnnotationEdit>, now: Partial<AnnotationEdit>): string {
  const stateOf = ({ state = "published" }: Partial<AnnotationEdit>) => state;
  const [category, wasCategory] = [categoryOf(now.category), categoryOf(before.category)];
  const found = [
    before.text === now.text ? "" : `text: ${now.text}`,
    category === wasCategory ? "" : `category: ${category.title}`,
    stateOf(before) === stateOf(now) ? "" : stateOf(now) === "draft" ? "made a draft" : "published",
    JSON.stringify(before.geometry) === JSON.stringify(now.geometry) ? "" : "redrawn",
  ];
  return found.filter(Boolean).join(", ") || "saved unchanged";
}

/** Annotations whose history is open: it stays open when the list is redrawn. */
const opened = new Set<string>();

/** A list that is loaded when it is opened. */
export function historyList(id: string, load: () => Promise<readonly Change[]>): HTMLElement {
  const list = h("ol");
  const fill = (changes: readonly Change[]) =>
    list.replaceChildren(
      ...changes.map(({ author, at, what }) =>
        h("li", {}, what, h("small", {}, `${author} · ${time(at)} UTC`)),
      ),
    );
  const details = h(
    "details",
    {
      class: "note-history",
      open: opened.has(id),
      ontoggle: () => {
        if (!details.open) opened.delete(id);
        else {
          opened.add(id);
          load().then(fill, () => list.replaceChildren("The history could not be fetched."));
        }
      },
    },
    h("summary", {}, "History"),
    list,
  );
  return details;
}
