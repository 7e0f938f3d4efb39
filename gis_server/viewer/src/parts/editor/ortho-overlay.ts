/** The orthophotos of two stops, one over the other: dragged, turned, faded; a click picks a feature in both. */

import { h } from "../../page/dom";
import { fixed } from "../../page/format";
import type { MapPoint } from "../../server/records";
import type { Mosaic } from "../../map/mosaic";
import { AS_MAPPED, type Placement, movedBy, turnedBy, under } from "./overlay-transform";

const CLICK_PX = 4;
const TURN_STEP_DEG = 0.2;
const WHEEL_STEP = 1.0015;

/** A place in the fixed orthophoto, and the place of the moved one that lies under it. */
export type OnClick = (fixedPlace: MapPoint, movedPlace: MapPoint) => void;

export class OrthoOverlay {
  readonly element: HTMLElement;
  private readonly canvas = h("canvas", {
    class: "image-canvas",
    tabindex: 0,
    role: "application",
    "aria-label": "two orthophotos: drag moves the second, arrows by a centimetre, [ and ] turn it",
  });
  private readonly status = h("p", { class: "image-status", role: "status" });
  private readonly fade = h("input", {
    type: "range",
    min: 0,
    max: 1,
    step: 0.05,
    value: 0.5,
    "aria-label": "opacity of the second orthophoto",
    oninput: () => this.redraw(),
  });
  private placement: Placement = AS_MAPPED;
  private pixelM = 0.1;
  private centre: MapPoint = [0, 0];
  private grabbed: { x: number; y: number; isDrag: boolean; moves: boolean } | null = null;
  private frame = 0;

  constructor(
    private readonly still: Mosaic,
    private readonly moved: Mosaic,
    private readonly onClick: OnClick,
  ) {
    const { canvas } = this;
    canvas.addEventListener("pointerdown", (event) => this.down(event));
    canvas.addEventListener("pointermove", (event) => this.move(event));
    canvas.addEventListener("pointerup", (event) => this.up(event));
    canvas.addEventListener("wheel", (event) => this.wheel(event), { passive: false });
    canvas.addEventListener("keydown", (event) => this.key(event));
    new ResizeObserver(() => this.redraw()).observe(canvas);
    const reset = () => this.setPlacement(AS_MAPPED);
    this.element = h(
      "section",
      { class: "pane overlay-pane" },
      h(
        "div",
        { class: "pane-head" },
        h("label", { class: "inline" }, "second", this.fade),
        h("button", { type: "button", class: "text", onclick: reset }, "as mapped"),
        h(
          "span",
          { class: "hint" },
          "drag: move the second · Alt+drag: move both · [ ]: turn · click: pick in both",
        ),
      ),
      canvas,
      this.status,
    );
    this.start();
  }

  private get middle(): MapPoint {
    const [west, south, east, north] = this.moved.bounds;
    return [(west + east) / 2, (south + north) / 2];
  }

  private start(): void {
    const [one, other] = [this.still.bounds, this.moved.bounds];
    const west = Math.max(one[0], other[0]);
    const south = Math.max(one[1], other[1]);
    const east = Math.min(one[2], other[2]);
    const north = Math.min(one[3], other[3]);
    const meets = east > west && north > south;
    const shown = meets ? ([west, south, east, north] as const) : one;
    this.centre = [(shown[0] + shown[2]) / 2, (shown[1] + shown[3]) / 2];
    this.pixelM = Math.max(shown[2] - shown[0], shown[3] - shown[1]) / 600;
    this.setPlacement(AS_MAPPED);
  }

  private setPlacement(placement: Placement): void {
    this.placement = placement;
    const { east, north, turnDeg } = placement;
    this.element.dataset["placement"] = [east, north, turnDeg]
      .map((value) => value.toFixed(4))
      .join(",");
    this.status.textContent = `second moved by E ${fixed(east, 3)} m, N ${fixed(north, 3)} m, turned by ${fixed(turnDeg, 2)}°`;
    this.redraw();
  }

  private place(event: MouseEvent): MapPoint {
    const box = this.canvas.getBoundingClientRect();
    const [x, y] = [
      event.clientX - box.left - box.width / 2,
      event.clientY - box.top - box.height / 2,
    ];
    return [this.centre[0] + x * this.pixelM, this.centre[1] - y * this.pixelM];
  }

  private down(event: PointerEvent): void {
    this.canvas.setPointerCapture(event.pointerId);
    this.grabbed = { x: event.clientX, y: event.clientY, isDrag: false, moves: !event.altKey };
  }

  private move(event: PointerEvent): void {
    const { grabbed } = this;
    if (!grabbed) return;
    const off = Math.hypot(event.clientX - grabbed.x, event.clientY - grabbed.y);
    if (off > CLICK_PX) grabbed.isDrag = true;
    if (!grabbed.isDrag) return;
    const [east, north] = [event.movementX * this.pixelM, -event.movementY * this.pixelM];
    if (grabbed.moves) this.setPlacement(movedBy(this.placement, east, north));
    else {
      this.centre = [this.centre[0] - east, this.centre[1] - north];
      this.redraw();
    }
  }

  private up(event: PointerEvent): void {
    const isClick = this.grabbed && !this.grabbed.isDrag;
    this.grabbed = null;
    if (!isClick) return;
    const place = this.place(event);
    this.onClick(place, under(this.placement, this.middle, place));
  }

  private wheel(event: WheelEvent): void {
    event.preventDefault();
    const held = this.place(event);
    this.pixelM *= WHEEL_STEP ** event.deltaY;
    const now = this.place(event);
    this.centre = [this.centre[0] + held[0] - now[0], this.centre[1] + held[1] - now[1]];
    this.redraw();
  }

  private key(event: KeyboardEvent): void {
    const next = KEYS[event.key]?.(this.placement);
    if (!next) return;
    event.preventDefault();
    event.stopPropagation();
    this.setPlacement(next);
  }

  private redraw(): void {
    cancelAnimationFrame(this.frame);
    this.frame = requestAnimationFrame(() => this.draw());
  }

  private draw(): void {
    const { canvas } = this;
    const [width, height] = [Math.max(canvas.clientWidth, 1), Math.max(canvas.clientHeight, 1)];
    if (canvas.width !== width) canvas.width = width;
    if (canvas.height !== height) canvas.height = height;
    const context = canvas.getContext("2d");
    if (!context) return;
    context.setTransform(1, 0, 0, 1, 0, 0);
    context.clearRect(0, 0, width, height);
    this.drawMosaic(context, this.still, AS_MAPPED);
    context.globalAlpha = Number(this.fade.value);
    this.drawMosaic(context, this.moved, this.placement);
    context.globalAlpha = 1;
  }

  /** Draws a mosaic at its placement, about the middle of the moved one. */
  private drawMosaic(
    context: CanvasRenderingContext2D,
    { canvas: mosaic, bounds, cellM }: Mosaic,
    placement: Placement,
  ): void {
    const { canvas, pixelM, centre } = this;
    const x = (east: number) => canvas.width / 2 + (east - centre[0]) / pixelM;
    const y = (north: number) => canvas.height / 2 - (north - centre[1]) / pixelM;
    const [me, mn] = this.middle;
    context.save();
    context.translate(x(me + placement.east), y(mn + placement.north));
    context.rotate((placement.turnDeg * Math.PI) / 180);
    context.translate(-x(me), -y(mn));
    const size = cellM / pixelM;
    context.drawImage(
      mosaic,
      x(bounds[0]),
      y(bounds[3]),
      mosaic.width * size,
      mosaic.height * size,
    );
    context.restore();
  }
}

const KEYS: Readonly<Record<string, (placement: Placement) => Placement>> = {
  ArrowLeft: (placement) => movedBy(placement, -0.01, 0),
  ArrowRight: (placement) => movedBy(placement, 0.01, 0),
  ArrowUp: (placement) => movedBy(placement, 0, 0.01),
  ArrowDown: (placement) => movedBy(placement, 0, -0.01),
  "[": (placement) => turnedBy(placement, -TURN_STEP_DEG),
  "]": (placement) => turnedBy(placement, TURN_STEP_DEG),
};
