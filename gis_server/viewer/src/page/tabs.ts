/** A rail of tabs that are added one by one; the first is selected. Arrow keys go from tab to tab. */

import { h, icon, type IconName } from "./dom";

/** An icon for every tab listed here; others have the first letter of their title. */
const ICON_OF_TAB: Readonly<Record<string, IconName>> = {
  point: "pin",
  images: "image",
  stops: "way",
  measure: "ruler",
  network: "ties",
  compare: "swipe",
  sun: "sun",
  downloads: "down",
  notes: "note",
  runs: "run",
};

export interface Tabs {
  readonly bar: HTMLElement;
  readonly panels: HTMLElement;
  /** Adds a tab; the panel it shows. */
  add(name: string, title: string): HTMLElement;
  /** Shows a tab; false if there is none of that name. */
  show(name: string): boolean;
  clear(): void;
}

interface Tab {
  readonly button: HTMLButtonElement;
  readonly panel: HTMLElement;
}

const STEPS: Readonly<Record<string, number>> = {
  ArrowUp: -1,
  ArrowLeft: -1,
  ArrowDown: 1,
  ArrowRight: 1,
};

function iconOf(name: string, title: string): Node {
  const known = ICON_OF_TAB[name];
  return known ? icon(known) : h("b", { "aria-hidden": "true" }, title.charAt(0));
}

/** Calls `opened` when a person or the session opens a tab. */
export function tabs(opened: (name: string) => void): Tabs {
  const bar = h("div", { class: "tabs", role: "tablist", "aria-orientation": "vertical" });
  const panels = h("div", { class: "panels" });
  const all = new Map<string, Tab>();
  const select = (name: string) => {
    for (const [each, { button, panel }] of all) {
      panel.hidden = each !== name;
      button.setAttribute("aria-selected", String(each === name));
      button.tabIndex = each === name ? 0 : -1;
    }
  };
  const show = (name: string) => {
    if (!all.has(name)) return false;
    select(name);
    opened(name);
    return true;
  };
  const add = (name: string, title: string) => {
    const [tabId, panelId] = [`tab-${name}`, `panel-${name}`];
    const panel = h("div", {
      class: "scroll",
      role: "tabpanel",
      id: panelId,
      tabindex: 0,
      "aria-labelledby": tabId,
    });
    const button = h(
      "button",
      {
        type: "button",
        role: "tab",
        id: tabId,
        "data-tab": name,
        "aria-controls": panelId,
        onclick: () => show(name),
      },
      iconOf(name, title),
      h("span", {}, title),
    );
    bar.append(button);
    panels.append(panel);
    all.set(name, { button, panel });
    select([...all.keys()][0] ?? name);
    return panel;
  };
  bar.addEventListener("keydown", ({ key }) => {
    const step = STEPS[key];
    if (step === undefined) return;
    const names = [...all.keys()];
    const at = names.findIndex((name) => all.get(name)?.button === document.activeElement);
    const next = names.at((at + step) % names.length);
    if (next === undefined) return;
    show(next);
    all.get(next)?.button.focus();
  });
  const clear = () => {
    all.clear();
    bar.replaceChildren();
    panels.replaceChildren();
  };
  return { bar, panels, add, show, clear };
}
