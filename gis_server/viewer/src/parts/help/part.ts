/** The list of keyboard shortcuts. */

import { h } from "../../page/dom";
import type { Context } from "../../session/context";

const NAMES: Readonly<Record<string, string>> = { Escape: "Esc" };

export function helpPart({ page, keys }: Context): void {
  const show = () => {
    const rows = keys.all.map(({ key, does }) =>
      h("tr", {}, h("td", {}, h("kbd", {}, NAMES[key] ?? key)), h("td", {}, does)),
    );
    page.dialog(
      "Keyboard shortcuts",
      h("table", { class: "values keys" }, h("tbody", {}, ...rows)),
    );
  };
  keys.add("?", "show this list", show);
  page.accountBox.append(
    h(
      "button",
      { type: "button", class: "text", title: "keyboard shortcuts (?)", onclick: show },
      "Shortcuts",
    ),
  );
}
