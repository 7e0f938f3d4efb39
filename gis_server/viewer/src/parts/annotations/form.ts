/** The form of an annotation: category, text and state. */

import { h } from "../../page/dom";
import type { AnnotationCategory, AnnotationEdit, AnnotationState } from "../../server/edits";
import { CATEGORIES } from "./categories";

/** Values of the form; the place is drawn on the map. */
export type Filled = Pick<AnnotationEdit, "text" | "category" | "state">;

/** The text of a form that was closed before it was saved, for the next one. */
const KEPT = "solmap-annotation-text";

export function annotationForm(known: Filled | null, save: (filled: Filled) => void): HTMLElement {
  const category = h(
    "select",
    { name: "category" },
    ...CATEGORIES.map(({ key, title }) => h("option", { value: key }, title)),
  );
  category.value = known?.category ?? "note";
  const text = h("textarea", {
    name: "text",
    rows: 3,
    required: true,
    maxlength: 4000,
    oninput: () => {
      if (!known) localStorage.setItem(KEPT, text.value);
    },
  });
  text.value = known?.text ?? localStorage.getItem(KEPT) ?? "";
  const draft = h("input", { type: "checkbox", name: "draft" });
  draft.checked = known?.state === "draft";
  return h(
    "form",
    {
      class: "note-form",
      onsubmit: (event) => {
        event.preventDefault();
        if (!known) localStorage.removeItem(KEPT);
        const state: AnnotationState = draft.checked ? "draft" : "published";
        save({ text: text.value.trim(), category: category.value as AnnotationCategory, state });
      },
    },
    h("label", {}, "Category ", category),
    h("label", {}, "Text", text),
    h("label", {}, draft, " Draft: on this map, not in OGC services and downloads"),
    h("button", { type: "submit", class: "primary" }, "Save"),
  );
}
