/**
 * Panes beside and below the map. Beside it there are as many as have room: side by side on a wide window, two one above
 * the other on a laptop; below it they stand side by side. On a small window there is one, beside the map if it is wider
 * than high, else below it. Where there is no room the oldest one closes. Dividers before them change their sizes; the
 * size left for the map is remembered in the browser.
 */

import { button, h } from "./dom";
import { OPENED } from "./fold";

export type Side = "beside" | "below";
/** Names of panes in their order. */
export type Arrangement = Readonly<Record<Side, readonly string[]>>;

export interface Pane {
  title(text: string): void;
  close(): void;
}

export interface Panes {
  readonly beside: HTMLElement;
  readonly below: HTMLElement;
  /** Opens a pane where the arrangement has it, else at the end of a side. */
  open(name: string, side: Side, title: string, content: Node, closed: () => void): Pane;
  /** Moves the panes that are open, and those that are opened later. */
  arrange(arrangement: Arrangement): void;
  /** Calls `arranged` when panes were opened, closed or moved here. */
  onArranged(arranged: (arrangement: Arrangement) => void): void;
  clear(): void;
}

interface Opened extends Pane {
  readonly name: string;
  readonly element: HTMLElement;
  readonly divider: HTMLElement;
  readonly moveButton: HTMLElement;
}

/** Least width of the map and of every pane, and least height where one is above another, pixels. */
const LEAST = { row: 320, column: 180 } as const;
const MOST_ACROSS = 3;
/** A window that is wider than high has room beside the map, not below it. */
const WIDE = matchMedia("(min-width: 1100px), (min-width: 700px) and (min-aspect-ratio: 5/4)");
const LAPTOP = matchMedia("(min-width: 1400px)");
/** Step of the arrow keys at a divider, pixels. */
const STEP_PX = 24;
const KEPT = "solmap-panes";
/** Share of the map above the panes that are below it: on a small window those have no other place. */
const above = () => (WIDE.matches ? 0.6 : 0.42);
const OTHER: Readonly<Record<Side, Side>> = { beside: "below", below: "beside" };

/** Shares of the map beside one, two and three columns of panes, and above those below. */
function keptShares(): Record<string, number> {
  try {
    return (JSON.parse(localStorage.getItem(KEPT) ?? "{}") ?? {}) as Record<string, number>;
  } catch {
    return {};
  }
}

const within = (value: number, least: number, most: number) =>
  Math.max(least, Math.min(most, value));

/** Number of panes that fit beside the map, and number of them side by side. */
export function roomFor(
  width: number,
  isWide: boolean,
  isLaptop: boolean,
): { readonly across: number; readonly most: number } {
  const across = within(Math.floor(width / LEAST.row) - 1, 1, isWide ? MOST_ACROSS : 1);
  return { across, most: Math.max(across, isLaptop ? 2 : 1) };
}

export function panes(): Panes {
  const shares = keptShares();
  const areas = {
    beside: h("div", { class: "panes beside", hidden: true }),
    below: h("div", { class: "panes below", hidden: true }),
  } as const;
  let arrangement: Arrangement = { beside: [], below: [] };
  let arranged: (arrangement: Arrangement) => void = () => undefined;
  /** Panes in the order in which they were opened. */
  let opened: readonly Opened[] = [];
  let isRow = true;

  /** Side on which a pane is shown. */
  const sideOf = (name: string): Side =>
    WIDE.matches && arrangement.beside.includes(name) ? "beside" : "below";
  const on = (side: Side) => {
    const order = [...arrangement.beside, ...arrangement.below];
    const some = opened.filter(({ name }) => sideOf(name) === side);
    return some.toSorted((a, b) => order.indexOf(a.name) - order.indexOf(b.name));
  };
  const room = (side: Side) => {
    const main = areas[side].parentElement;
    return side === "beside"
      ? (main?.clientWidth ?? innerWidth)
      : (main?.clientHeight ?? innerHeight);
  };
  const columns = () => (isRow ? on("beside").length : 1);
  const keyOf = (side: Side) => (side === "below" ? side : String(columns()));
  /** Size left for the map, pixels. */
  const mapSize = (side: Side) => {
    const [least, usual] =
      side === "beside"
        ? ([LEAST.row, 1 / (columns() + 1)] as const)
        : ([LEAST.column, above()] as const);
    const most = room(side) - (side === "beside" ? columns() : 1) * least;
    return within((shares[keyOf(side)] ?? usual) * room(side), Math.min(least, most), most);
  };
  const isAcross = (side: Side) => side === "below" || isRow;
  const sizeOf = (side: Side, { element }: Opened) =>
    isAcross(side) ? element.offsetWidth : element.offsetHeight;

  const fit = () => {
    const width = room("beside");
    const { across, most } = roomFor(width, WIDE.matches, LAPTOP.matches);
    const mostBelow = WIDE.matches ? Math.max(1, Math.floor(width / LEAST.row)) : 1;
    for (const [side, room] of [["beside", most] as const, ["below", mostBelow] as const]) {
      const some = on(side);
      if (some.length > room) {
        opened.find((one) => some.includes(one))?.close(); // fits into the window again
        return;
      }
    }
    isRow = on("beside").length <= across;
    for (const side of ["beside", "below"] as const) {
      const area = areas[side];
      const some = on(side);
      area.hidden = some.length === 0;
      area.dataset["direction"] = isAcross(side) ? "row" : "column";
      const parts = some.flatMap(({ divider, element }) => [divider, element]);
      if (parts.some((part, k) => area.children[k] !== part)) area.append(...parts);
      area.style.setProperty("--panes", `${Math.round(room(side) - mapSize(side))}px`);
      some.forEach(({ name, divider, moveButton }, k) => {
        const isFirst = k === 0;
        const isUpright = isFirst ? side === "beside" : isAcross(side);
        divider.setAttribute("aria-orientation", isUpright ? "vertical" : "horizontal");
        moveButton.hidden = !WIDE.matches;
        const to = `move ${OTHER[sideOf(name)]} the map`;
        moveButton.title = to;
        moveButton.setAttribute("aria-label", to);
      });
      some.forEach((_, k) => showSize(side, k));
    }
  };
  /** Sets the share before a divider in its ARIA value, percent. */
  const showSize = (side: Side, k: number) => {
    const [before, pane] = [on(side)[k - 1], on(side)[k]];
    const share =
      before && pane
        ? sizeOf(side, before) / (sizeOf(side, before) + sizeOf(side, pane))
        : mapSize(side) / room(side);
    pane?.divider.setAttribute("aria-valuenow", String(Math.round(100 * share)));
  };
  const move = (pane: Opened, px: number) => {
    const side = sideOf(pane.name);
    const some = on(side);
    const at = some.indexOf(pane);
    const before = some[at - 1];
    if (!before) {
      const least = side === "beside" ? LEAST.row : LEAST.column;
      shares[keyOf(side)] = within(mapSize(side) + px, least, room(side)) / room(side);
      localStorage.setItem(KEPT, JSON.stringify(shares));
      fit();
      return;
    }
    const sizes = some.map((one) => sizeOf(side, one));
    const [first = 0, second = 0] = [sizes[at - 1], sizes[at]];
    const least = LEAST[isAcross(side) ? "row" : "column"];
    const moved = within(first + px, least, Math.max(least, first + second - least));
    sizes[at - 1] = moved;
    sizes[at] = first + second - moved;
    some.forEach((one, k) => one.element.style.setProperty("flex-grow", String(sizes[k])));
    showSize(side, at);
  };
  /** Takes a pane out of the arrangement, and puts it at the end of a side. */
  const put = (name: string, side: Side | null) => {
    const others = (one: Side) => arrangement[one].filter((other) => other !== name);
    arrangement = { beside: others("beside"), below: others("below") };
    if (side) arrangement = { ...arrangement, [side]: [...arrangement[side], name] };
    arranged(arrangement);
  };

  const dividerOf = (title: string, pane: () => Opened) => {
    const isUpright = () => divider.getAttribute("aria-orientation") === "vertical";
    const drag = ({ buttons, movementX, movementY }: PointerEvent) => {
      if (buttons & 1) move(pane(), isUpright() ? movementX : movementY);
    };
    const key = (event: KeyboardEvent) => {
      const [less, more] = isUpright() ? ["ArrowLeft", "ArrowRight"] : ["ArrowUp", "ArrowDown"];
      const steps = event.key === less ? -1 : event.key === more ? 1 : 0;
      if (steps === 0) return;
      event.preventDefault();
      event.stopPropagation();
      move(pane(), steps * STEP_PX);
    };
    const divider = h("div", {
      class: "pane-divider",
      role: "separator",
      tabindex: 0,
      "aria-label": `room before ${title}`,
      "aria-valuemin": 0,
      "aria-valuemax": 100,
    });
    divider.addEventListener("pointerdown", ({ pointerId }) =>
      divider.setPointerCapture(pointerId),
    );
    divider.addEventListener("pointermove", drag);
    divider.addEventListener("keydown", key);
    return divider;
  };

  const open = (name: string, side: Side, title: string, content: Node, closed: () => void) => {
    const heading = h("h2", {}, title);
    const element = h("section", { class: "dock pane", "aria-label": title, "data-pane": name });
    const moveButton = button("", "panel", () => {
      put(name, OTHER[sideOf(name)]);
      fit();
      moveButton.focus();
    });
    const pane: Opened = {
      name,
      element,
      moveButton,
      divider: dividerOf(title, () => pane),
      title: (text) => {
        heading.textContent = text;
        element.setAttribute("aria-label", text);
      },
      close: () => {
        if (!opened.includes(pane)) return;
        opened = opened.filter((one) => one !== pane);
        pane.divider.remove();
        element.remove();
        put(name, null);
        fit();
        closed();
      },
    };
    element.append(
      h(
        "div",
        { class: "dock-head" },
        heading,
        h(
          "span",
          { class: "inline" },
          moveButton,
          button("close", "close", () => pane.close()),
        ),
      ),
      h("div", { class: "dock-body" }, content),
    );
    opened = [...opened, pane];
    const main = areas.beside.parentElement;
    if (main) resized.observe(main);
    if (!arrangement.beside.includes(name) && !arrangement.below.includes(name)) put(name, side);
    fit();
    element.dispatchEvent(new CustomEvent(OPENED, { bubbles: true, detail: "dock" }));
    return pane;
  };

  for (const width of [WIDE, LAPTOP]) width.addEventListener("change", fit);
  /** Side panels that open and close change the room too. */
  const resized = new ResizeObserver(fit);
  return {
    ...areas,
    open,
    arrange: (requested) => {
      arrangement = requested;
      fit();
    },
    onArranged: (listener) => {
      arranged = listener;
    },
    clear: () => {
      arranged = () => undefined;
      for (const pane of opened) pane.close();
      arrangement = { beside: [], below: [] };
    },
  };
}
