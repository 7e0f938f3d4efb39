/** The page around the map: bars, panels, banner and dialogs. No knowledge of what they hold. */

import { urls } from "./api";
import { button, h } from "./dom";

export const TABS = ["point", "images", "stops"] as const;
export type Tab = (typeof TABS)[number];
const TAB_TITLES: Readonly<Record<Tab, string>> = {
  point: "Point",
  images: "Images",
  stops: "Stops",
};

export type Theme = "light" | "dark";

export interface Shell {
  readonly map: HTMLElement;
  readonly layers: HTMLElement;
  readonly missionBox: HTMLElement;
  readonly toolbar: HTMLElement;
  readonly readout: HTMLElement;
  readonly scale: HTMLElement;
  readonly north: HTMLElement;
  readonly ruler: HTMLElement;
  readonly tip: HTMLElement;
  readonly panels: Readonly<Record<Tab, HTMLElement>>;
  showTab(tab: Tab): void;
  /** Shows a message across the top, with a button; null takes it away. */
  banner(message: string | null, retry?: () => void): void;
  dialog(title: string, content: Node): void;
}

function toggleTheme(): void {
  const root = document.documentElement;
  const dark = root.dataset["theme"]
    ? root.dataset["theme"] === "dark"
    : matchMedia("(prefers-color-scheme: dark)").matches;
  const theme: Theme = dark ? "light" : "dark";
  root.dataset["theme"] = theme;
  localStorage.setItem("solmap-theme", theme);
}

function tabs(panels: Readonly<Record<Tab, HTMLElement>>) {
  const buttons = new Map<Tab, HTMLButtonElement>();
  const showTab = (tab: Tab) => {
    for (const name of TABS) {
      panels[name].hidden = name !== tab;
      buttons.get(name)?.setAttribute("aria-selected", String(name === tab));
    }
  };
  for (const name of TABS) {
    buttons.set(
      name,
      h(
        "button",
        { type: "button", role: "tab", "data-tab": name, onclick: () => showTab(name) },
        TAB_TITLES[name],
      ),
    );
  }
  const bar = h("div", { class: "tabs", role: "tablist" }, ...buttons.values());
  return { bar, showTab };
}

export function shell(root: HTMLElement): Shell {
  const theme = localStorage.getItem("solmap-theme");
  if (theme === "light" || theme === "dark") document.documentElement.dataset["theme"] = theme;

  const map = h("div", { class: "map", tabindex: 0, role: "application", "aria-label": "map" });
  const layers = h("div", { class: "scroll" });
  const missionBox = h("div", { class: "mission" });
  const toolbar = h("div", { class: "toolbar", role: "toolbar", "aria-label": "map tools" });
  const readout = h("div", { class: "readout", "aria-live": "off" });
  const scale = h("div", { class: "scale" });
  const north = h("div", { class: "north" });
  const ruler = h("div", { class: "ruler", role: "status", hidden: true });
  const tip = h("div", { class: "tip", hidden: true });
  const notice = h("div", { class: "banner", role: "alert", hidden: true });
  const panel = () => h("div", { class: "scroll", role: "tabpanel" });
  const panels = { point: panel(), images: panel(), stops: panel() };
  const { bar, showTab } = tabs(panels);
  const dialog = h("dialog", { class: "dialog" });
  dialog.addEventListener("click", (event) => {
    if (event.target === dialog) dialog.close();
  });

  root.replaceChildren(
    h(
      "header",
      {},
      h("h1", {}, "solmap"),
      missionBox,
      h("a", { class: "text", href: urls.docs() }, "API"),
      button("light or dark", "sun", toggleTheme, { class: "ghost" }),
    ),
    h("aside", { class: "left", "aria-label": "layers" }, layers),
    h("main", {}, map, toolbar, north, scale, ruler, tip, notice),
    h("aside", { class: "right", "aria-label": "what is here" }, bar, ...Object.values(panels)),
    h("footer", {}, readout),
    dialog,
  );
  showTab("point");
  return {
    map,
    layers,
    missionBox,
    toolbar,
    readout,
    scale,
    north,
    ruler,
    tip,
    panels,
    showTab,
    banner(message, retry) {
      notice.hidden = message === null;
      notice.replaceChildren(h("span", {}, message ?? ""));
      if (retry) notice.append(h("button", { type: "button", onclick: retry }, "Try again"));
    },
    dialog(title, content) {
      dialog.replaceChildren(
        h(
          "div",
          { class: "dialog-head" },
          h("h2", {}, title),
          button("close", "close", () => dialog.close()),
        ),
        content,
      );
      dialog.showModal();
    },
  };
}
