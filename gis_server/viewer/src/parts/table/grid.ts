/** Rows on the screen: only those in view are in the page. One of them is chosen, by mouse or arrow keys. */

import {
  elementScroll,
  observeElementOffset,
  observeElementRect,
  Virtualizer,
} from "@tanstack/virtual-core";
import { h } from "../../page/dom";
import { cellText, type Column, type Row } from "./rows";

const ROW_PX = 26;
const OVERSCAN = 6;

export interface GridActions {
  readonly sort: (column: Column) => void;
  readonly choose: (row: Row) => void;
  /** A row was double-clicked, or Enter was pressed on it. */
  readonly open: (row: Row) => void;
}

export interface Sorting {
  readonly sort: string | null;
  readonly isDescending: boolean;
}

export class Grid {
  readonly element: HTMLElement;
  private readonly body = h("div", { role: "rowgroup", class: "table-body" });
  private readonly head = h("div", { role: "row", class: "table-row table-head" });
  private readonly virtual: Virtualizer<HTMLElement, HTMLElement>;
  private readonly unmount: () => void;
  private rows: readonly Row[] = [];
  private columns: readonly Column[] = [];
  private chosen = -1;

  constructor(private readonly actions: GridActions) {
    this.element = h(
      "div",
      { role: "grid", class: "table-grid", tabindex: 0 },
      h("div", { role: "rowgroup", class: "table-top" }, this.head),
      this.body,
    );
    this.element.addEventListener("keydown", (event) => this.pressed(event));
    this.body.addEventListener("click", (event) => this.pick(rowAt(event)));
    this.body.addEventListener("dblclick", (event) => {
      const row = this.rows[rowAt(event)];
      if (row) actions.open(row);
    });
    this.virtual = new Virtualizer<HTMLElement, HTMLElement>(this.options());
    this.unmount = this.virtual._didMount();
  }

  /** The element is on the page now. */
  mounted(): void {
    this.virtual._willUpdate();
    this.draw();
  }

  dispose(): void {
    this.unmount();
  }

  show(title: string, columns: readonly Column[], rows: readonly Row[], sorting: Sorting): void {
    const id = this.rows[this.chosen]?.id;
    [this.columns, this.rows] = [columns, rows];
    this.chosen = id === undefined ? -1 : rows.findIndex((row) => row.id === id);
    const { element } = this;
    element.setAttribute("aria-label", title);
    element.setAttribute("aria-rowcount", String(rows.length + 1));
    element.style.setProperty("--columns", columns.map(({ width }) => `${width}ch`).join(" "));
    this.head.replaceChildren(...columns.map((column) => this.heading(column, sorting)));
    this.virtual.setOptions(this.options());
    this.virtual.measure();
    this.body.style.height = `${this.virtual.getTotalSize()}px`;
    this.draw();
  }

  /** Marks a row and brings it into view; false where it is not listed. */
  mark(id: string): boolean {
    const at = this.rows.findIndex((row) => row.id === id);
    this.chosen = at;
    if (at >= 0) this.virtual.scrollToIndex(at, { align: "auto" });
    this.draw();
    return at >= 0;
  }

  private options() {
    return {
      count: this.rows.length,
      getScrollElement: () => this.element,
      estimateSize: () => ROW_PX,
      scrollToFn: elementScroll,
      observeElementRect,
      observeElementOffset,
      scrollMargin: ROW_PX,
      scrollPaddingStart: ROW_PX,
      overscan: OVERSCAN,
      onChange: () => this.draw(),
    };
  }

  private heading(column: Column, { sort, isDescending }: Sorting): HTMLElement {
    const { key, title, unit } = column;
    const isSorted = sort === key;
    const order = isDescending ? "descending" : "ascending";
    const arrow = isDescending ? " ▾" : " ▴";
    const name = unit ? `${title}, ${unit}` : title;
    return h(
      "div",
      {
        role: "columnheader",
        class: unit ? "number" : null,
        "aria-sort": isSorted ? order : "none",
      },
      h(
        "button",
        { type: "button", title: `sort by ${title}`, onclick: () => this.actions.sort(column) },
        name,
        isSorted ? h("span", { "aria-hidden": "true" }, arrow) : null,
      ),
    );
  }

  private draw(): void {
    const items = this.virtual.getVirtualItems();
    this.body.replaceChildren(...items.map(({ index, start }) => this.line(index, start - ROW_PX)));
    const chosen = this.body.querySelector('[aria-selected="true"]');
    if (chosen) this.element.setAttribute("aria-activedescendant", chosen.id);
    else this.element.removeAttribute("aria-activedescendant");
  }

  private line(index: number, top: number): HTMLElement {
    const row = this.rows[index];
    if (!row) return h("div");
    const cells = this.columns.map((column) => {
      const text = cellText(row, column);
      const isNumber = typeof row.values[column.key] === "number";
      return h("div", { role: "gridcell", class: isNumber ? "number" : null, title: text }, text);
    });
    return h(
      "div",
      {
        role: "row",
        id: `table-row-${index}`,
        class: "table-row",
        "data-row": row.id,
        "data-index": index,
        "aria-rowindex": index + 2,
        "aria-selected": String(index === this.chosen),
        style: `transform:translateY(${top}px)`,
      },
      ...cells,
    );
  }

  private pick(index: number): void {
    const row = this.rows[index];
    if (!row) return;
    this.mark(row.id);
    this.actions.choose(row);
  }

  private pressed(event: KeyboardEvent): void {
    if (event.target !== this.element) return;
    const page = Math.max(1, Math.floor(this.element.clientHeight / ROW_PX) - 2);
    const last = this.rows.length - 1;
    const at = this.chosen;
    const steps: Readonly<Record<string, number>> = {
      ArrowDown: at + 1,
      ArrowUp: at - 1,
      PageDown: at + page,
      PageUp: at - page,
      Home: 0,
      End: last,
    };
    const next = steps[event.key];
    const row = this.rows[at];
    if (next !== undefined) this.pick(Math.min(last, Math.max(0, next)));
    else if (event.key === "Enter" && row) this.actions.open(row);
    else return;
    event.preventDefault();
    event.stopPropagation(); // the arrow keys would move the map
  }
}

const rowAt = ({ target }: Event): number =>
  Number((target as HTMLElement).closest<HTMLElement>("[data-index]")?.dataset["index"] ?? -1);
