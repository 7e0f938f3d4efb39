/**
 * The open side panels: both on a wide window; on a narrow one neither at first, and one at a time.
 */

import { button, type IconName } from "./dom";

const WIDE = "(min-width: 1100px)";
/** Dispatched by the panel, or the dock, that opens; its name is the detail. */
export const OPENED = "fold-opened";

type Side = "layers" | "panel" | "dock";

export interface Fold {
  /** Opens and closes the panel. */
  readonly button: HTMLButtonElement;
  open(): void;
}

/** Records in `data-SIDE` of `root` whether a panel is open; the layout follows (`layout.css`). */
export function fold(root: HTMLElement, side: Side, name: string, image: IconName): Fold {
  const wide = matchMedia(WIDE);
  const show = (isOpen: boolean) => {
    root.dataset[side] = isOpen ? "open" : "closed";
    toggle.setAttribute("aria-expanded", String(isOpen));
    if (isOpen) root.dispatchEvent(new CustomEvent(OPENED, { detail: side }));
  };
  root.addEventListener(OPENED, (event) => {
    const other = (event as CustomEvent<Side>).detail;
    if (other !== side && !wide.matches) show(false);
  });
  const toggle = button(name, image, () => show(root.dataset[side] !== "open"), {
    class: "ghost",
  });
  wide.addEventListener("change", () => show(wide.matches));
  show(wide.matches);
  return { button: toggle, open: () => show(true) };
}
