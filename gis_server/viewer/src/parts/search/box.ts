/** The search box: a list below it follows what is typed; arrow keys choose, Enter goes there, Escape closes. */

import { h } from "../../page/dom";
import type { Entry } from "./find";

export interface SearchBox {
  readonly element: HTMLElement;
  readonly focus: () => void;
  /** Searches again after the entries have loaded. */
  readonly refresh: () => void;
}

export interface SearchActions {
  /** The text was changed, or the box was entered. */
  readonly find: (text: string) => readonly Entry[];
  readonly entered: () => void;
  readonly go: (entry: Entry) => void;
}

const option = (place: number) => `search-option-${place}`;

export function searchBox({ find, entered, go }: SearchActions): SearchBox {
  let found: readonly Entry[] = [];
  let chosen = 0;
  const list = h("ul", { id: "search-list", role: "listbox", "aria-label": "found", hidden: true });
  const none = h("p", { class: "hint", role: "status", hidden: true }, "Nothing found.");
  const input = h("input", {
    type: "search",
    placeholder: "sol, stop, image, coordinates ( / )",
    "aria-label": "search",
    role: "combobox",
    "aria-autocomplete": "list",
    "aria-controls": "search-list",
    "aria-expanded": "false",
    autocomplete: "off",
    spellcheck: "false",
    oninput: () => search(),
    onfocus: () => {
      entered();
      search();
    },
    onblur: () => {
      show([]);
      none.hidden = true;
    },
    onkeydown: (event) => pressed(event as KeyboardEvent),
  });
  const choose = (place: number) => {
    chosen = (place + found.length) % Math.max(1, found.length);
    [...list.children].forEach((row, k) => row.setAttribute("aria-selected", String(k === chosen)));
    list.children[chosen]?.scrollIntoView({ block: "nearest" });
    if (found.length > 0) input.setAttribute("aria-activedescendant", option(chosen));
    else input.removeAttribute("aria-activedescendant");
  };
  const take = (entry: Entry | undefined) => {
    if (!entry) return;
    input.value = entry.title;
    input.blur();
    go(entry);
  };
  const show = (entries: readonly Entry[]) => {
    found = entries;
    const isOpen = entries.length > 0;
    list.hidden = !isOpen;
    input.setAttribute("aria-expanded", String(isOpen));
    list.replaceChildren(
      ...entries.map((entry, place) =>
        h(
          "li",
          {
            role: "option",
            id: option(place),
            "data-goal": entry.goal.to,
            onpointerdown: (event) => {
              event.preventDefault(); // the box keeps the focus until the choice is made
              take(entry);
            },
          },
          h("span", {}, entry.title),
          h("small", {}, entry.detail),
        ),
      ),
    );
    choose(0);
  };
  const search = () => {
    show(find(input.value));
    none.hidden = input.value.trim() === "" || found.length > 0;
  };
  const pressed = (event: KeyboardEvent) => {
    if (event.key === "ArrowDown" || event.key === "ArrowUp") {
      event.preventDefault();
      choose(chosen + (event.key === "ArrowDown" ? 1 : -1));
    } else if (event.key === "Enter") take(found[chosen]);
    else if (event.key === "Escape") {
      event.stopPropagation();
      input.value = "";
      input.blur();
    }
  };
  return {
    element: h("div", { class: "search", role: "search" }, input, list, none),
    refresh: () => {
      if (document.activeElement === input) search();
    },
    focus: () => {
      input.focus();
      input.select();
    },
  };
}
