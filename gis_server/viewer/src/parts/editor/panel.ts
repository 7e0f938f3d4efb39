/** The strip below the images: the pick, the planned ties, the result of a trial with them, and the saved ones. */

import { button, h } from "../../page/dom";
import { fixed, scopeTitle, time } from "../../page/format";
import type { Edit } from "../../server/edits";
import type { Trial } from "../../server/ties";
import type { Draft, Pick } from "./draft";

export interface EditorActions {
  readonly refine: () => void;
  readonly plan: () => void;
  readonly drop: (row: number) => void;
  readonly trial: () => void;
  readonly save: () => void;
  readonly undo: (id: number) => void;
}

const act = (name: string, text: string, enabled: boolean, run: () => void) =>
  h(
    "button",
    { type: "button", class: "primary", "data-act": name, disabled: !enabled, onclick: run },
    text,
  );

function pickText(pick: Pick | null): string {
  if (!pick) return "not picked";
  const sigma = pick.sigma_px === null ? "" : ` ± ${fixed(pick.sigma_px, 2)}`;
  return `sample ${fixed(pick.sample, 2)}, line ${fixed(pick.line, 2)}${sigma}`;
}

function plannedTable({ planned, trial }: Draft, actions: EditorActions): HTMLElement {
  const rows = planned.map(({ first, second }, row) => {
    const result = trial?.ties.find(({ tie }) => tie === row);
    return h(
      "tr",
      { "data-planned": row, "data-status": result?.status ?? "" },
      h("td", {}, first.image),
      h("td", {}, second.image),
      h(
        "td",
        { class: "number" },
        result?.residual_px != null ? `${fixed(result.residual_px, 2)} px` : "–",
      ),
      h(
        "td",
        {},
        result
          ? result.status === "blunder"
            ? "contradicts the others"
            : result.status
          : "not tried",
      ),
      h(
        "td",
        {},
        button("drop this tie", "close", () => actions.drop(row), { class: "ghost" }),
      ),
    );
  });
  const head = ["first image", "second image", "residual", "trial", ""];
  return h(
    "table",
    { class: "values" },
    h("thead", {}, h("tr", {}, ...head.map((name) => h("th", {}, name)))),
    h("tbody", {}, ...rows),
  );
}

export function trialText({ moved_stop, change, before, after, notes }: Trial): string {
  const { east_m, north_m, up_m, azimuth_deg, sigma_east_m, sigma_north_m } = change;
  const sigma = (value: number | null) => (value === null ? "–" : fixed(value, 2));
  const moved = `${scopeTitle(moved_stop)} would move by E ${fixed(east_m, 3)}, N ${fixed(north_m, 3)}, up ${fixed(up_m, 3)} m and turn by ${fixed(azimuth_deg, 3)}° (then ± ${fixed(sigma_east_m, 3)}, ${fixed(sigma_north_m, 3)} m)`;
  const fit = `sigma0 ${sigma(before.sigma0)} → ${sigma(after.sigma0)}, cross-site ties ${before.cross_site_ties} → ${after.cross_site_ties}`;
  return [moved, fit, ...notes].join("; ");
}

function savedList(saved: readonly Edit[], mayWrite: boolean, actions: EditorActions): HTMLElement {
  const rows = saved.map((edit) => {
    const { action, first_image, second_image } = edit.document;
    const what = `${String(action)} ${String(first_image)} – ${String(second_image ?? "")}`;
    return h(
      "li",
      { class: "note-row", "data-saved": edit.id },
      h("span", {}, what),
      h("small", {}, `${edit.author} · ${time(edit.at)} UTC`),
      mayWrite
        ? button("take this tie back", "close", () => actions.undo(edit.id), { class: "ghost" })
        : null,
    );
  });
  if (rows.length === 0) return h("p", { class: "hint" }, "No tie was edited by hand yet.");
  return h("ul", { class: "plain" }, ...rows);
}

export function editorPanel(
  draft: Draft,
  saved: readonly Edit[],
  mayWrite: boolean,
  status: string,
  actions: EditorActions,
): HTMLElement {
  const both = draft.first !== null && draft.second !== null;
  const any = draft.planned.length > 0;
  return h(
    "div",
    { class: "editor-panel" },
    h(
      "div",
      { class: "editor-acts" },
      h("span", { "data-pick": "first" }, pickText(draft.first)),
      h("span", { "data-pick": "second" }, pickText(draft.second)),
      act("refine", "Refine", both, actions.refine),
      act("plan", "Add tie", both, actions.plan),
      act("trial", "Preview adjustment", any, actions.trial),
      act("save", "Save", any && mayWrite, actions.save),
      mayWrite ? null : h("span", { class: "hint" }, "Sign in as an analyst to save."),
    ),
    h(
      "p",
      { class: "editor-status", role: "status" },
      draft.trial ? trialText(draft.trial) : status,
    ),
    h(
      "div",
      { class: "editor-lists" },
      any ? plannedTable(draft, actions) : h("p", { class: "hint" }, "No tie is planned."),
      savedList(saved, mayWrite, actions),
    ),
  );
}
