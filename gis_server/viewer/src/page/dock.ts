/** Room over the map that one thing at a time may use. */

import { button, h } from "./dom";

export interface Dock {
  readonly element: HTMLElement;
  /** Shows `content` under a title; the earlier content is closed first. */
  open(title: string, content: Node, onClose?: () => void): void;
  close(): void;
  readonly isOpen: boolean;
}

export function dock(): Dock {
  const element = h("section", { class: "dock bench", hidden: true });
  let closed: (() => void) | undefined;
  const close = () => {
    if (element.hidden) return;
    element.hidden = true;
    element.replaceChildren();
    const onClose = closed;
    closed = undefined;
    onClose?.();
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
    },
    close,
    get isOpen() {
      return !element.hidden;
    },
  };
}
