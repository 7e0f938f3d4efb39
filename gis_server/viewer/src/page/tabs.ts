/** A rail of tabs that are added one by one; the first is selected. Arrow keys go from tab to tab. */

import { h, icon, type IconName } from "./dom";

/** Titles and icons of tabs, and the keys that open them. */
const KINDS = {
  point: ["Identify", "pin", "I"],
  images: ["Images", "image", "G"],
  stops: ["Traverse", "way", "T"],
  measure: ["Measure", "ruler", "M"],
  network: ["Network", "ties", "K"],
  compare: ["Compare", "swipe", "C"],
  sun: ["Sun", "sun", "S"],
  downloads: ["Download", "down", "D"],
  notes: ["Notes", "note", "N"],
  runs: ["Runs", "run", "R"],
} as const satisfies Record<string, readonly [string, IconName, string]>;
export type Tab = keyof typeof KINDS;
/** Tabs in their order; the first is open at the beginning. */
export const TABS = Object.keys(KINDS) as readonly Tab[];
export const TAB_KEYS = TABS.map((name) => [KINDS[name][2], name, KINDS[name][0]] as const);

export interface Tabs {
  readonly bar: HTMLElement;
  readonly panels: HTMLElement;
  /** Adds a tab; the panel it shows. */
  add(name: Tab): HTMLElement;
  show(name: Tab): void;
  /** Shows a tab, of which the Tab key reaches the first control next. */
  enter(name: Tab): void;
  clear(): void;
}

interface Added {
  readonly button: HTMLButtonElement;
  readonly panel: HTMLElement;
}

const STEPS: Readonly<Record<string, number>> = {
  ArrowUp: -1,
  ArrowLeft: -1,
  ArrowDown: 1,
  ArrowRight: 1,
};

/** Calls `opened` when a person or the session opens a tab. */
export function tabs(opened: (name: Tab) => void): Tabs {
  const bar = h("div", { class: "tabs", role: "tablist", "aria-orientation": "vertical" });
  const panels = h("div", { class: "panels" });
  const all = new Map<Tab, Added>();
  const select = (name: Tab) => {
    for (const [each, { button, panel }] of all) {
      panel.hidden = each !== name;
      button.setAttribute("aria-selected", String(each === name));
      button.tabIndex = each === name ? 0 : -1;
    }
  };
  const show = (name: Tab) => {
    if (!all.has(name)) return;
    select(name);
    opened(name);
  };
  const enter = (name: Tab) => {
    show(name);
    all.get(name)?.panel.focus();
  };
  const add = (name: Tab) => {
    const [title, picture, shortcut] = KINDS[name];
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
        title: `${title} (${shortcut})`,
        onclick: () => show(name),
      },
      icon(picture),
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
  return { bar, panels, add, show, enter, clear };
}
