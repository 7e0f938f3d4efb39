/** Rows on the screen: only those in view are in the page. One of them is chosen, by mouse or arrow keys. */

import {
  elementScroll,
  observeElementOffset,
  observeElementRect,
  Virtualizer,
} from "@tanstack/virtual-core";
import { h } from "../../page/dom";
import type { Table } from "../../session/state";
import { cellText, type Column, type Row } from "./rows";

const ROW_PX = 26;
/** Width of a digit, and what a cell has beside its text. */
const [DIGIT_PX, PADDING_PX] = [6.8, 12];
const OVERSCAN = 6;

export interface GridActions {
  readonly sort: (column: Column) => void;
  readonly choose: (row: Row) => void;
  /** A row was double-clicked, or Enter was pressed on it. */
  readonly open: (row: Row) => void;
}

export type Shown = Pick<Table, "sort" | "isDescending" | "hasAllColumns">;

const sum = (values: readonly number[]) => values.reduce((all, one) => all + one, 0);
const widthPx = ({ width }: Column) => Math.ceil(width * DIGIT_PX + PADDING_PX);

/** The columns that have room, the first ones first; the one that rows are sorted by is among them. */
export function fitting(
  columns: readonly Column[],
  roomPx: number,
  sort: string | null,
): readonly Column[] {
  const isFixed = ({ key }: Column, k: number) => k === 0 || key === sort;
  let room = roomPx - sum(columns.filter(isFixed).map(widthPx));
  let isFull = false;
  return columns.filter((column, k) => {
    if (isFixed(column, k)) return true;
    isFull ||= widthPx(column) > room;
    room -= widthPx(column);
    return !isFull;
  });
}

export class Grid {
  readonly element: HTMLElement;
  private readonly body = h("div", { role: "rowgroup", class: "table-body" });
  private readonly head = h("div", { role: "row", class: "table-row table-head" });
  private readonly virtual: Virtualizer<HTMLElement, HTMLElement>;
  private readonly unmount: () => void;
  private rows: readonly Row[] = [];
  private all: readonly Column[] = [];
  private columns: readonly Column[] = [];
  private requested: Shown = { sort: null, isDescending: false, hasAllColumns: false };
  private readonly observer = new ResizeObserver(() => this.lay());
  private chosen = -1;

  /** `fitted` receives the number of columns in view. */
  constructor(
    private readonly actions: GridActions,
    private readonly fitted: (count: number) => void,
  ) {
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
    this.observer.observe(this.element);
  }

  /** The element is on the page now. */
  mounted(): void {
    this.virtual._willUpdate();
    this.draw();
  }

  dispose(): void {
    this.observer.disconnect();
    this.unmount();
  }

  show(title: string, columns: readonly Column[], rows: readonly Row[], requested: Shown): void {
    const id = this.rows[this.chosen]?.id;
    [this.all, this.rows, this.requested] = [columns, rows, requested];
    this.chosen = id === undefined ? -1 : rows.findIndex((row) => row.id === id);
    const { element } = this;
    element.setAttribute("aria-label", title);
    element.setAttribute("aria-rowcount", String(rows.length + 1));
    this.lay();
    this.virtual.setOptions(this.options());
    this.virtual.measure();
    this.body.style.height = `${this.virtual.getTotalSize()}px`;
    this.draw();
  }

  /** Chooses columns by the width of the table. */
  private lay(): void {
    const { all, element, requested } = this;
    this.columns = requested.hasAllColumns
      ? all
      : fitting(all, element.clientWidth, requested.sort);
    const widths = this.columns.map((column) => `minmax(${widthPx(column)}px, ${column.width}fr)`);
    element.style.setProperty("--columns", widths.join(" "));
    element.style.setProperty("--least", `${sum(this.columns.map(widthPx))}px`);
    this.head.replaceChildren(...this.columns.map((column) => this.heading(column)));
    this.fitted(this.columns.length);
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

  private heading(column: Column): HTMLElement {
    const { key, title, unit } = column;
    const { sort, isDescending } = this.requested;
    const isSorted = sort === key;
    const order = isDescending ? "descending" : "ascending";
    const arrow = isDescending ? " ▾" : " ▴";
    const name = unit ? `${title}, ${unit}` : title;
    return h(
      "div",
      {
        role: "columnheader",
        class: this.rows.some(({ values }) => typeof values[key] === "number") ? "number" : null,
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
