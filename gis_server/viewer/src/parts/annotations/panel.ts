/** The tab of notes. */

import type { Shape } from "../../map/sketch";
import { button, h } from "../../page/dom";
import { time } from "../../page/format";
import type { AnnotationFeature } from "../../server/edits";

export interface NoteActions {
  readonly start: (shape: Shape) => void;
  readonly zoomTo: (id: string) => void;
  readonly takeBack: (id: string) => void;
}

const SHAPES: readonly (readonly [Shape, string])[] = [
  ["point", "Place"],
  ["line", "Line"],
  ["area", "Area"],
];

export function annotationsPanel(
  notes: readonly AnnotationFeature[],
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
  const rows = notes.map(({ id, properties }) =>
    h(
      "li",
      { class: "note-row", "data-note": id },
      h(
        "button",
        { type: "button", class: "link", onclick: () => actions.zoomTo(id) },
        properties.text,
      ),
      h("small", {}, `${properties.author} · ${time(properties.at)} UTC`),
      mayWrite
        ? button("take the note back", "close", () => actions.takeBack(id), { class: "ghost" })
        : null,
    ),
  );
  return h(
    "div",
    {},
    mayWrite
      ? h("div", { class: "wishes" }, ...tools)
      : h("p", { class: "hint" }, "Sign in as an analyst to write notes on the map."),
    rows.length > 0
      ? h("ul", { class: "plain" }, ...rows)
      : h("p", { class: "hint" }, "Nobody has written a note yet."),
  );
}
