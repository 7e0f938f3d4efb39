/** A drawing that the wheel zooms and dragging moves, by its view box. */

import { h } from "../../page/dom";

interface Box {
  readonly x: number;
  readonly y: number;
  readonly side: number;
}

/** Scale (screen pixels per unit of the drawing) from which on all names are shown. */
const NAMES_FROM = 1.1;
const [CLOSEST, WIDEST] = [1 / 16, 1.5];

/** The box after zooming by a factor about a point of the drawing, which stays where it is. */
export function zoomedBox(
  { x, y, side }: Box,
  factor: number,
  about: readonly [number, number],
  whole: number,
): Box {
  const next = Math.min(WIDEST * whole, Math.max(CLOSEST * whole, side * factor));
  const grown = next / side;
  return { x: about[0] - (about[0] - x) * grown, y: about[1] - (about[1] - y) * grown, side: next };
}

export function zoomable(drawing: SVGSVGElement): HTMLElement {
  const whole = drawing.viewBox.baseVal.width;
  let box: Box = { x: 0, y: 0, side: whole };
  const put = (next: Box) => {
    box = next;
    drawing.setAttribute("viewBox", `${box.x} ${box.y} ${box.side} ${box.side}`);
    setUnit();
  };
  /** Texts and marks keep their size on the screen. */
  const setUnit = () => {
    drawing.style.setProperty("--unit", unit().toFixed(4));
    drawing.classList.toggle("close", unit() < 1 / NAMES_FROM);
  };
  /** Units of the drawing per pixel of the screen. */
  const unit = () => box.side / Math.max(1, Math.min(drawing.clientWidth, drawing.clientHeight));
  const at = ({ clientX, clientY }: MouseEvent): readonly [number, number] => {
    const point = new DOMPoint(clientX, clientY).matrixTransform(drawing.getScreenCTM()?.inverse());
    return [point.x, point.y];
  };
  drawing.addEventListener(
    "wheel",
    (event) => {
      event.preventDefault();
      put(zoomedBox(box, 1.0015 ** event.deltaY, at(event), whole));
    },
    { passive: false },
  );
  drawing.addEventListener("pointermove", ({ buttons, movementX, movementY }) => {
    if ((buttons & 1) === 0) return;
    put({ ...box, x: box.x - movementX * unit(), y: box.y - movementY * unit() });
  });
  new ResizeObserver(setUnit).observe(drawing);
  drawing.addEventListener("dblclick", () => put({ x: 0, y: 0, side: whole }));
  return h("div", { class: "network-sheet" }, drawing);
}
