/** The dialog of saved views: save, open, rename, replace, delete, and the file that holds them. */

import { type Child, h } from "../../page/dom";
import { saveFile } from "../../page/save";
import { formatViews, freeName, merged, parseViews, type SavedView, SavedViews } from "./saved";

export interface ViewActions {
  readonly open: (link: string) => void;
  /** The link to what is shown now. */
  readonly now: () => string;
}

const action = (name: string, of: string, run: () => void) =>
  h("button", { type: "button", class: "link", "aria-label": `${name} ${of}`, onclick: run }, name);

/** The content of a link in one line, without `session/state.ts`, which the first view would then fetch. */
function describe(link: string): string {
  const query = new URLSearchParams(link.slice(1));
  const [count, sol] = [query.get("on")?.split(",").filter(Boolean).length, query.get("sol")];
  const layers = count === undefined ? "" : `${count} ${count === 1 ? "layer" : "layers"}`;
  return [query.get("m"), layers, sol && `sol ${sol}`].filter(Boolean).join(" · ");
}

export function viewsDialog({ open, now }: ViewActions): HTMLElement {
  const saved = new SavedViews();
  const error = h("p", { class: "error", role: "alert" });
  const list = h("ul", { class: "plain saved-views" });
  let deleted: SavedView | null = null;

  /** Changes the views, draws them and moves the focus, because the focused element is replaced. */
  const change = (make: (views: readonly SavedView[]) => readonly SavedView[], focus: string) => {
    try {
      saved.keep(make);
      error.textContent = "";
    } catch {
      error.textContent = "The browser keeps nothing more: delete views or export them.";
    }
    draw();
    element.querySelector<HTMLElement>(focus)?.focus();
  };
  const only = (view: SavedView) => (one: SavedView) =>
    one.name === view.name && one.link === view.link;
  const replace = (view: SavedView, by: readonly SavedView[], focus: string) =>
    change((views) => views.flatMap((one) => (only(view)(one) ? by : [one])), focus);

  const rename = (view: SavedView, row: HTMLElement, at: number) => {
    const field = nameField(view.name, `new name of ${view.name}`);
    const keep = () => {
      const others = saved.all.filter((one) => !only(view)(one));
      const name = freeName(field.value.trim() || view.name, others);
      replace(view, [{ ...view, name }], focusOf(at));
    };
    const cancel = () => {
      draw();
      element.querySelector<HTMLElement>(focusOf(at))?.focus();
    };
    field.addEventListener("keydown", (event) => {
      if (event.key !== "Escape") return;
      event.preventDefault(); // the dialog stays open
      event.stopPropagation();
      cancel();
    });
    row.replaceChildren(form(keep, field, submit("Rename"), action("Cancel", "renaming", cancel)));
    field.select();
  };
  const rowOf = (view: SavedView, at: number) => {
    const { name, link } = view;
    const row = h("li", { "data-view": name });
    const remove = () => {
      deleted = view;
      replace(view, [], ".restore");
    };
    row.append(
      h("button", { type: "button", class: "link open", onclick: () => open(link) }, name),
      h("small", {}, describe(link)),
      h(
        "div",
        { class: "inline" },
        action("Rename", name, () => rename(view, row, at)),
        action("Replace", `${name} by what is shown now`, () =>
          replace(view, [{ name, link: now() }], focusOf(at)),
        ),
        action("Delete", name, remove),
      ),
    );
    return row;
  };
  const restore = () => {
    const view = deleted;
    deleted = null;
    if (view) change((views) => merged(views, [view]), "li:last-child .open");
  };
  const draw = () => {
    const views = saved.all;
    list.replaceChildren(...views.map(rowOf));
    again.hidden = deleted === null;
    again.textContent = `Restore ${deleted?.name ?? ""}`;
    none.hidden = views.length > 0;
    exported.disabled = views.length === 0;
    title.value = freeName("View", views);
  };

  const title = nameField("", "name of the view");
  const save = () =>
    change((views) => {
      const name = freeName(title.value.trim() || "View", views);
      return [...views, { name, link: now() }];
    }, "li:last-child .open");
  const file = h("input", {
    type: "file",
    accept: ".json,application/json",
    class: "off-screen",
    tabindex: -1,
    "aria-label": "file of saved views",
    onchange: () => {
      const [chosen] = file.files ?? [];
      file.value = "";
      void chosen?.text().then(take);
    },
  });
  const take = (text: string) => {
    try {
      const more = parseViews(text);
      change((views) => merged(views, more), ".import");
    } catch (reason) {
      error.textContent = reason instanceof Error ? reason.message : String(reason);
    }
  };
  const plain = (name: string, kind: string, run: () => void) =>
    h("button", { type: "button", class: `plain ${kind}`, onclick: run }, name);
  const exported = plain("Export", "export", () =>
    saveFile("solmap-views.json", "application/json", formatViews(saved.all)),
  );
  const again = plain("", "restore", restore);
  const none = h("p", { class: "hint" }, "No view is saved in this browser yet.");
  const element = h(
    "div",
    { class: "views" },
    h("p", { class: "hint" }, "A view is everything that the link holds: place, layers, sol, tab."),
    form(save, title, submit("Save this view")),
    list,
    none,
    error,
    h(
      "div",
      { class: "inline" },
      exported,
      plain("Import", "import", () => file.click()),
      again,
    ),
    file,
  );
  draw();
  return element;
}

const focusOf = (at: number) => `li:nth-child(${at + 1}) .open`;

const nameField = (value: string, label: string) =>
  h("input", { type: "text", value, maxlength: 80, required: true, "aria-label": label });

const submit = (name: string) => h("button", { type: "submit", class: "primary" }, name);

const form = (run: () => void, ...children: readonly Child[]) =>
  h(
    "form",
    {
      class: "inline",
      onsubmit: (event) => {
        event.preventDefault();
        run();
      },
    },
    ...children,
  );
