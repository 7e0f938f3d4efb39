/**
 * Panes beside the map. Their number depends on the width: side by side on
 * a wide window, two one above the other on a laptop, one on a small window; if there is no space, the oldest one
 * closes. Dividers resize them; the share of the map is remembered in the browser.
 */

import { button, h } from "./dom";

export interface Pane {
  readonly element: HTMLElement;
  title(text: string): void;
  close(): void;
}

export interface Panes {
  readonly element: HTMLElement;
  open(title: string, content: Node, onClose?: () => void): Pane;
  clear(): void;
}

interface Opened extends Pane {
  readonly divider: HTMLElement;
}

/** Least size of the map and every pane, pixels: across, and down where one pane is above the other. */
const LEAST = { row: 320, column: 180 } as const;
const MOST_ACROSS = 3;
const WIDE = matchMedia("(min-width: 1100px)");
const LAPTOP = matchMedia("(min-width: 1400px)");
/** Step of the arrow keys at a divider, pixels. */
const STEP_PX = 24;
const KEPT = "solmap-panes";

/** Shares of the map beside one, two and three columns of panes. */
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
  const element = h("div", { class: "panes", hidden: true });
  const shares = keptShares();
  let opened: readonly Opened[] = [];
  let isRow = true;

  const width = () => element.parentElement?.clientWidth ?? innerWidth;
  const columns = () => (isRow ? opened.length : 1);
  const sizeOf = ({ element: pane }: Pane) => (isRow ? pane.offsetWidth : pane.offsetHeight);
  const mapWidth = () => {
    const most = width() - columns() * LEAST.row;
    const share = shares[columns()] ?? 1 / (columns() + 1);
    return within(share * width(), Math.min(LEAST.row, most), most);
  };

  const fit = () => {
    const { across, most } = roomFor(width(), WIDE.matches, LAPTOP.matches);
    if (opened.length > most) {
      opened[0]?.close(); // fits again
      return;
    }
    isRow = opened.length <= across;
    element.hidden = opened.length === 0;
    element.dataset["direction"] = isRow ? "row" : "column";
    element.style.setProperty("--panes", `${Math.round(width() - mapWidth())}px`);
    opened.forEach(({ divider }, k) => {
      const isUpright = isRow || k === 0;
      divider.setAttribute("aria-orientation", isUpright ? "vertical" : "horizontal");
    });
    opened.forEach((_, k) => tell(k));
  };
  /** Sets the share before a divider in its ARIA value, percent. */
  const tell = (k: number) => {
    const [before, pane] = [opened[k - 1], opened[k]];
    const share =
      before && pane ? sizeOf(before) / (sizeOf(before) + sizeOf(pane)) : mapWidth() / width();
    pane?.divider.setAttribute("aria-valuenow", String(Math.round(100 * share)));
  };
  const move = (pane: Opened, px: number) => {
    const at = opened.indexOf(pane);
    const before = opened[at - 1];
    if (!before) {
      shares[columns()] = within(mapWidth() + px, LEAST.row, width()) / width();
      localStorage.setItem(KEPT, JSON.stringify(shares));
      fit();
      return;
    }
    const sizes = opened.map(sizeOf);
    const [first = 0, second = 0] = [sizes[at - 1], sizes[at]];
    const least = LEAST[isRow ? "row" : "column"];
    const moved = within(first + px, least, Math.max(least, first + second - least));
    sizes[at - 1] = moved;
    sizes[at] = first + second - moved;
    opened.forEach((one, k) => one.element.style.setProperty("flex-grow", String(sizes[k])));
    tell(at);
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

  const open = (title: string, content: Node, onClose?: () => void): Pane => {
    const heading = h("h2", {}, title);
    const body = h("section", { class: "dock pane", "aria-label": title });
    const pane: Opened = {
      element: body,
      divider: dividerOf(title, () => pane),
      title: (text) => {
        heading.textContent = text;
        body.setAttribute("aria-label", text);
      },
      close: () => {
        if (!opened.includes(pane)) return;
        opened = opened.filter((one) => one !== pane);
        pane.divider.remove();
        body.remove();
        fit();
        onClose?.();
      },
    };
    body.append(
      h("div", { class: "dock-head" }, heading, button("close", "close", pane.close)),
      h("div", { class: "dock-body" }, content),
    );
    element.append(pane.divider, body);
    opened = [...opened, pane];
    fit();
    return pane;
  };

  for (const width of [WIDE, LAPTOP]) width.addEventListener("change", fit);
  addEventListener("resize", fit);
  return {
    element,
    open,
    clear: () => {
      for (const pane of opened) pane.close();
    },
  };
}
