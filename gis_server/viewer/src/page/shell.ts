/** The page around the map: bars, panels, banner and dialogs. Independent of their content. */

import { urls } from "../server/api";
import { type Dock, dock } from "./dock";
import { button, h } from "./dom";
import { fold } from "./fold";
import { type Panes, panes } from "./panes";
import { type Tab, tabs } from "./tabs";

const TOAST_MS = 6000;

export type Theme = "light" | "dark";

export interface Shell {
  readonly map: HTMLElement;
  readonly layers: HTMLElement;
  readonly missionBox: HTMLElement;
  readonly searchBox: HTMLElement;
  /** Box at the end of the head: help, the signed-in account. */
  readonly accountBox: HTMLElement;
  readonly toolbar: HTMLElement;
  readonly readout: HTMLElement;
  /** Box at the end of the line below the map: the format of coordinates. */
  readonly formatBox: HTMLElement;
  /** Box in the line below the map: state of server and engine. */
  readonly statusBox: HTMLElement;
  /** Shown while the server is not connected. */
  readonly connectionLost: HTMLElement;
  readonly scale: HTMLElement;
  readonly legend: HTMLElement;
  readonly north: HTMLElement;
  readonly ruler: HTMLElement;
  readonly tip: HTMLElement;
  /** Room beside and below the map. */
  readonly panes: Panes;
  /** Room over the map, for work that needs all of it: the tie-point editor. */
  readonly bench: Dock;
  /** Adds a tab on the right; the panel it shows. */
  addTab(name: Tab): HTMLElement;
  showTab(name: Tab): void;
  /** Shows a tab and moves the focus there. */
  enterTab(name: Tab): void;
  /** Calls `shown` with the name of every tab that is shown from now on. */
  onTab(shown: (name: Tab) => void): void;
  /** `name` stands below its icon where there is room. */
  addTool(tool: HTMLElement, name: string): void;
  /** Shows the panel of layers if it is folded away. */
  openLayers(): void;
  /** Takes away what the last session added. */
  clear(): void;
  /** Shows a message across the top, with a button; null removes it. */
  banner(message: string | null, act?: () => void, label?: string): void;
  dialog(title: string, content: Node): void;
  closeDialog(): void;
  /** Shows a message that needs no answer and disappears by itself. */
  toast(message: string): void;
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

export function shell(root: HTMLElement): Shell {
  const theme = localStorage.getItem("solmap-theme");
  if (theme === "light" || theme === "dark") document.documentElement.dataset["theme"] = theme;

  const map = h("div", { class: "map", tabindex: 0, role: "application", "aria-label": "map" });
  const layers = h("div", { class: "scroll" });
  const missionBox = h("div", { class: "mission" });
  const searchBox = h("div", { class: "search-box" });
  const accountBox = h("div", { class: "account" });
  const toolbar = h("div", { class: "toolbar", role: "toolbar", "aria-label": "map tools" });
  const readout = h("div", { class: "readout", "aria-live": "off" });
  const formatBox = h("div", {});
  const statusBox = h("div", { class: "status" });
  const connectionLost = h(
    "output",
    { class: "connection", hidden: true },
    "Not connected: what is published does not appear until the server answers.",
  );
  const scale = h("div", { class: "scale" });
  const legend = h("div", {});
  const north = h("div", { class: "north" });
  const ruler = h("div", { class: "ruler", role: "status", hidden: true });
  const tip = h("div", { class: "tip", hidden: true });
  const toast = h("div", { class: "toast", role: "status" });
  const notice = h("div", { class: "banner", role: "alert", hidden: true });
  const layersFold = fold(root, "layers", "layers panel", "layers");
  const panelFold = fold(root, "panel", "side panel", "panel");
  let tabShown: (name: Tab) => void = () => undefined;
  const right = tabs((name) => {
    panelFold.open();
    tabShown(name);
  });
  const areas = panes();
  const bench = dock();
  const dialog = h("dialog", { class: "dialog" });
  dialog.addEventListener("click", (event) => {
    if (event.target === dialog) dialog.close();
  });

  root.replaceChildren(
    h("button", { type: "button", class: "skip", onclick: () => map.focus() }, "Skip to the map"),
    h(
      "header",
      {},
      layersFold.button,
      h("h1", {}, "solmap"),
      missionBox,
      searchBox,
      h("a", { class: "text", href: urls.docs() }, "API"),
      accountBox,
      button("light or dark", "sun", toggleTheme, { class: "ghost" }),
      panelFold.button,
    ),
    h("aside", { class: "left", "aria-label": "layers" }, layers),
    h(
      "main",
      {},
      h(
        "div",
        { class: "field-of-map" },
        map,
        toolbar,
        north,
        scale,
        legend,
        ruler,
        tip,
        toast,
        notice,
      ),
      areas.beside,
      areas.below,
      bench.element,
    ),
    h("aside", { class: "right", "aria-label": "side panel" }, right.bar, right.panels),
    h("footer", {}, readout, connectionLost, statusBox, formatBox),
    dialog,
  );
  return {
    map,
    layers,
    missionBox,
    searchBox,
    accountBox,
    toolbar,
    readout,
    formatBox,
    statusBox,
    connectionLost,
    scale,
    legend,
    north,
    ruler,
    tip,
    panes: areas,
    bench,
    addTab: right.add,
    showTab: right.show,
    enterTab: right.enter,
    onTab(shown) {
      tabShown = shown;
    },
    openLayers: layersFold.open,
    addTool(tool, name) {
      tool.append(h("span", {}, name));
      toolbar.append(tool);
    },
    clear() {
      tabShown = () => undefined;
      right.clear();
      areas.clear();
      bench.close();
      for (const element of [
        map,
        layers,
        searchBox,
        accountBox,
        toolbar,
        north,
        scale,
        legend,
        readout,
        formatBox,
        statusBox,
      ])
        element.replaceChildren();
      for (const element of [ruler, tip]) element.hidden = true;
    },
    banner(message, act, label = "Try again") {
      notice.hidden = message === null;
      notice.replaceChildren(h("span", {}, message ?? ""));
      if (act) notice.append(h("button", { type: "button", onclick: act }, label));
    },
    toast(message) {
      const line = h("div", {}, message);
      toast.append(line);
      setTimeout(() => line.remove(), TOAST_MS);
    },
    closeDialog: () => dialog.close(),
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
