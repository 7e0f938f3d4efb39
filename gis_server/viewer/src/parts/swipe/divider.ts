/** The line across the map between two layers: dragged, or moved with the arrow keys. */

import { h } from "../../page/dom";

const STEP = 0.02;

export interface Divider {
  readonly element: HTMLElement;
  readonly set: (share: number) => void;
}

/** `left` and `right` are the names of what lies on its sides; `moved` gets shares of the map's width. */
export function divider(
  map: HTMLElement,
  left: string,
  right: string,
  moved: (share: number) => void,
): Divider {
  let at = 0.5;
  const set = (share: number) => {
    at = Math.min(1, Math.max(0, share));
    element.style.left = `${100 * at}%`;
    element.setAttribute("aria-valuenow", String(Math.round(100 * at)));
  };
  const move = (share: number) => {
    set(share);
    moved(at);
  };
  const element = h(
    "div",
    {
      class: "divider",
      role: "slider",
      tabindex: 0,
      "aria-label": `divider between ${left} and ${right}`,
      "aria-valuemin": 0,
      "aria-valuemax": 100,
    },
    h("span", { class: "side side-a" }, left),
    h("span", { class: "grip", "aria-hidden": "true" }, "⇔"),
    h("span", { class: "side side-b" }, right),
  );
  element.addEventListener("pointerdown", (event) => {
    event.preventDefault();
    element.focus();
    element.setPointerCapture(event.pointerId);
  });
  element.addEventListener("pointermove", (event) => {
    if (!element.hasPointerCapture(event.pointerId)) return;
    const box = map.getBoundingClientRect();
    move((event.clientX - box.left) / box.width);
  });
  element.addEventListener("keydown", (event) => {
    const steps: Readonly<Record<string, number>> = {
      ArrowLeft: -STEP,
      ArrowRight: STEP,
      Home: -1,
      End: 1,
    };
    const step = steps[event.key];
    if (step === undefined) return;
    event.preventDefault();
    event.stopPropagation();
    move(at + step);
  });
  set(0.5);
  return { element, set };
}
