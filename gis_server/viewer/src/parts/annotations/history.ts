/** History of annotations: author, time and fields of each change, and those that were deleted. */

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

/** An annotation that was deleted last as it is in the log. */
export interface Deleted {
  readonly id: number;
  readonly annotation: AnnotationEdit;
  /** The edit that deleted it; undoing this edit restores it. */
  readonly deletion: Edit;
}

/** Annotations without effect that were neither replaced nor moved to another map, the last deleted one first. */
export function deletedOf(log: readonly Edit[]): readonly Deleted[] {
  const replaced = new Set(log.map(({ document }) => document["replaces"]));
  const annotations = new Map(
    log.filter(({ kind, counts }) => kind === "annotation" && !counts).map((one) => [one.id, one]),
  );
  return log
    .filter(({ kind, counts, note }) => kind === "undo" && counts && !note.startsWith("moved to "))
    .flatMap((deletion) => {
      const found = annotations.get(deletion.undoes ?? 0);
      if (!found || replaced.has(found.id)) return [];
      return [{ id: found.id, annotation: found.document as unknown as AnnotationEdit, deletion }];
    })
    .reverse();
}

/** Changes of the annotation that an edit of the log wrote, the newest first. */
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

/** Lists that are open: they stay so when the panel is drawn again. */
const opened = new Set<string>();

/** A list that is loaded when it is opened; `name` is unique to it. */
export function openList(
  name: string,
  title: string,
  load: () => Promise<readonly HTMLElement[]>,
): HTMLElement {
  const list = h("ol");
  const details = h(
    "details",
    {
      class: "note-history",
      open: opened.has(name),
      ontoggle: () => {
        if (!details.open) opened.delete(name);
        else {
          opened.add(name);
          load().then(
            (rows) => list.replaceChildren(...rows),
            () => list.replaceChildren("The log could not be fetched."),
          );
        }
      },
    },
    h("summary", {}, title),
    list,
  );
  return details;
}

export const historyList = (id: number, log: () => Promise<readonly Edit[]>): HTMLElement =>
  openList(String(id), "History", async () =>
    historyOf(await log(), id).map(({ author, at, what }) =>
      h("li", {}, what, h("small", {}, `${author} · ${time(at)} UTC`)),
    ),
  );
