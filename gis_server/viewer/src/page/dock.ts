/** Area below or over the map for one content at a time. */

import { button, h } from "./dom";
import { OPENED } from "./fold";

export interface Dock {
  readonly element: HTMLElement;
  /** Shows `content` under a title; the earlier content is closed first. */
  open(title: string, content: Node, onClose?: () => void): void;
  close(): void;
  readonly isOpen: boolean;
}

export function dock(side: "below" | "bench"): Dock {
  const element = h("section", { class: `dock ${side}`, hidden: true });
  let closed: (() => void) | undefined;
  const close = () => {
    if (element.hidden) return;
    element.hidden = true;
    element.replaceChildren();
    const tell = closed;
    closed = undefined;
    tell?.();
  };
  return {
    element,
    open(title, content, onClose) {
      close();
      closed = onClose;
      element.setAttribute("aria-label", title);
      const head = h(
        "div",
        { class: "dock-head" },
        h("h2", {}, title),
        button("close", "close", close),
      );
      element.replaceChildren(head, h("div", { class: "dock-body" }, content));
      element.hidden = false;
      element.dispatchEvent(new CustomEvent(OPENED, { bubbles: true, detail: "dock" }));
    },
    close,
    get isOpen() {
      return !element.hidden;
    },
  };
}
