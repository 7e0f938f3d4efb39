/** Help: the list of keys, and a guided tour that is offered on the first visit. */

import "./help.css";
import { h } from "../../page/dom";
import type { Context } from "../../session/context";

const NAMES: Readonly<Record<string, string>> = { Escape: "Esc" };
/** Key in the browser's storage, set when the tour was seen or declined. */
const SEEN = "solmap-tour";

export function helpPart(context: Context): void {
  const { page, keys, waiting } = context;
  const tour = () => {
    localStorage.setItem(SEEN, "seen");
    page.closeDialog();
    waiting.run(async () => {
      const { showTour } = await import("./tour");
      showTour(() => help.focus());
    });
  };
  const show = () => {
    const uses = new Map<string, string[]>();
    for (const { key, does } of keys.all) uses.set(key, [...(uses.get(key) ?? []), does]);
    const rows = [...uses].map(([key, does]) =>
      h("tr", {}, h("td", {}, h("kbd", {}, NAMES[key] ?? key)), h("td", {}, does.join(", "))),
    );
    page.dialog(
      "Keyboard shortcuts",
      h(
        "div",
        {},
        action("Take the tour", tour),
        h("table", { class: "values keys" }, h("tbody", {}, ...rows)),
      ),
    );
  };
  const help = h(
    "button",
    { type: "button", class: "text help", title: "keyboard shortcuts and tour (?)", onclick: show },
    "Help",
  );
  keys.add("?", "show this list", show);
  page.accountBox.append(help);
  offer(context, tour);
}

const action = (title: string, run: () => void) =>
  h("button", { type: "button", class: "plain", onclick: run }, title);

/** Offers the tour on the first visit, except to a program that controls the browser. */
function offer({ page, signal }: Context, tour: () => void): void {
  if (localStorage.getItem(SEEN) || navigator.webdriver) return;
  const close = () => {
    localStorage.setItem(SEEN, "declined");
    note.remove();
  };
  const take = () => {
    close();
    tour();
  };
  const note = h(
    "div",
    { class: "tour-offer", role: "region", "aria-label": "tour" },
    "New here?",
    action("Take the tour", take),
    action("No, thanks", close),
  );
  page.map.after(note);
  signal.addEventListener("abort", () => note.remove());
}
