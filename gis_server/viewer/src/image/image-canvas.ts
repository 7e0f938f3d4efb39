/** An image on a canvas: zoomed by wheel and keys, moved by dragging, stretched, with marks drawn over it. */

import { h } from "../page/dom";
import type { ImageSight } from "../session/state";
import { drawOverlay, type Overlay } from "./overlay";
import { applied, lookUp, NO_STRETCH, type Stretch } from "./stretch";
import {
  centred,
  fitted,
  type ImagePoint,
  isInside,
  panned,
  refitted,
  type ScreenPoint,
  type Size,
  toImage,
  type Viewport,
  zoomed,
} from "./viewport";

/** Magnification from which on pixels are shown as squares. */
const SHARP_FROM = 3;
const CLICK_PX = 4;
const PAN_PX = 60;
const WHEEL_STEP = 1.0015;

export interface ImageCanvasListener {
  /** The pointer is at a place of the image; null: it is not over the image. */
  readonly hover: (at: ImagePoint | null, screen: ScreenPoint) => void;
  readonly click: (at: ImagePoint) => void;
  /** Called with the visible part; null: the whole image. */
  readonly moved: (sight: ImageSight | null) => void;
}

export class ImageCanvas {
  readonly element = h("canvas", { class: "image-canvas", tabindex: 0, role: "application" });
  viewport: Viewport = { scale: 1, left: 0, top: 0 };
  private raw: ImageData | null = null;
  private shown: OffscreenCanvas | null = null;
  private overlay: Overlay = { ties: [], residualFactor: 0, cross: null };
  private isWhole = true;
  /** Size of the view that `viewport` is for. */
  private seenIn: Size = [1, 1];
  private frame = 0;
  private grabbed: { readonly x: number; readonly y: number; isDrag: boolean } | null = null;

  constructor(private readonly listener: ImageCanvasListener) {
    const { element } = this;
    element.addEventListener("wheel", (event) => this.wheel(event), { passive: false });
    element.addEventListener("pointerdown", (event) => this.down(event));
    element.addEventListener("pointermove", (event) => this.move(event));
    element.addEventListener("pointerup", (event) => this.up(event));
    element.addEventListener("pointerleave", () => listener.hover(null, [0, 0]));
    element.addEventListener("keydown", (event) => this.key(event));
    element.addEventListener("focus", () => this.redraw());
    element.addEventListener("blur", () => this.redraw());
    new ResizeObserver(() => this.resized()).observe(element);
  }

  /** Samples and lines of the image that is shown. */
  get size(): Size {
    return this.raw ? [this.raw.width, this.raw.height] : [1, 1];
  }

  get pixels(): Uint8ClampedArray {
    return this.raw?.data ?? new Uint8ClampedArray();
  }

  /** Shows another image: the whole, or a part. */
  async load(url: string, name: string, sight: ImageSight | null = null): Promise<void> {
    const image = h("img", { src: url });
    await image.decode();
    const canvas = new OffscreenCanvas(image.naturalWidth, image.naturalHeight);
    const paper = canvas.getContext("2d", { willReadFrequently: true });
    paper?.drawImage(image, 0, 0);
    this.raw = paper?.getImageData(0, 0, canvas.width, canvas.height) ?? null;
    this.element.setAttribute(
      "aria-label",
      `image ${name}; arrows move it, plus and minus zoom, Enter picks the middle`,
    );
    this.stretch(NO_STRETCH);
    this.look(sight);
  }

  /** Grey value of a pixel; null outside. */
  grey([sample, line]: ImagePoint): number | null {
    if (!this.raw || !isInside([sample, line], this.size)) return null;
    return this.raw.data[4 * (Math.round(line) * this.raw.width + Math.round(sample))] ?? null;
  }

  stretch(stretch: Stretch): void {
    if (!this.raw) return;
    const { width, height, data } = this.raw;
    const canvas = new OffscreenCanvas(width, height);
    const pixels = new Uint8ClampedArray(applied(data, lookUp(stretch)));
    canvas.getContext("2d")?.putImageData(new ImageData(pixels, width, height), 0, 0);
    this.shown = canvas;
    this.redraw();
  }

  put(part: Partial<Overlay>): void {
    this.overlay = { ...this.overlay, ...part };
    this.redraw();
  }

  fit(): void {
    this.isWhole = true;
    this.set(fitted(this.size, this.room));
  }

  look(sight: ImageSight | null): void {
    if (sight) this.centre([sight.sample, sight.line], sight.scale);
    else this.fit();
  }

  /** Brings a point into the middle, at least so large that pixels are seen. */
  centre(point: ImagePoint, scale = Math.max(this.viewport.scale, 2)): void {
    this.isWhole = false;
    this.set(centred(point, scale, this.size, this.room));
  }

  zoom(factor: number, about: ScreenPoint = [this.room[0] / 2, this.room[1] / 2]): void {
    this.isWhole = false;
    this.set(zoomed(this.viewport, factor, about, this.size, this.room));
  }

  private get room(): Size {
    return [Math.max(this.element.clientWidth, 1), Math.max(this.element.clientHeight, 1)];
  }

  private set(viewport: Viewport): void {
    this.viewport = viewport;
    this.seenIn = this.room;
    const [width, height] = this.seenIn;
    const [sample, line] = toImage(viewport, [width / 2, height / 2]);
    this.listener.moved(this.isWhole ? null : { sample, line, scale: viewport.scale });
    this.redraw();
  }

  private pan(dx: number, dy: number): void {
    this.isWhole = false;
    this.set(panned(this.viewport, dx, dy, this.size, this.room));
  }

  private resized(): void {
    if (this.isWhole) this.fit();
    else this.set(refitted(this.viewport, this.seenIn, this.size, this.room));
  }

  private at({ clientX, clientY }: MouseEvent): ScreenPoint {
    const box = this.element.getBoundingClientRect();
    return [clientX - box.left, clientY - box.top];
  }

  private wheel(event: WheelEvent): void {
    event.preventDefault();
    this.zoom(WHEEL_STEP ** -event.deltaY, this.at(event));
  }

  private down(event: PointerEvent): void {
    this.element.setPointerCapture(event.pointerId);
    this.grabbed = { x: event.clientX, y: event.clientY, isDrag: false };
  }

  private move(event: PointerEvent): void {
    const screen = this.at(event);
    if (this.grabbed) {
      const off = Math.hypot(event.clientX - this.grabbed.x, event.clientY - this.grabbed.y);
      if (off > CLICK_PX) this.grabbed.isDrag = true;
      if (this.grabbed.isDrag) this.pan(event.movementX, event.movementY);
      return;
    }
    const at = toImage(this.viewport, screen);
    this.listener.hover(isInside(at, this.size) ? at : null, screen);
  }

  private up(event: PointerEvent): void {
    const isClick = this.grabbed && !this.grabbed.isDrag;
    this.grabbed = null;
    const at = toImage(this.viewport, this.at(event));
    if (isClick && isInside(at, this.size)) this.listener.click(at);
  }

  private key(event: KeyboardEvent): void {
    const act = KEYS[event.key];
    if (!act || event.ctrlKey || event.metaKey || event.altKey) return;
    event.preventDefault();
    event.stopPropagation();
    act(this);
  }

  /** For the keys alone. */
  step(dx: number, dy: number): void {
    this.pan(dx * PAN_PX, dy * PAN_PX);
  }

  /** For the keys alone. */
  pickMiddle(): void {
    const [width, height] = this.room;
    const at = toImage(this.viewport, [width / 2, height / 2]);
    if (isInside(at, this.size)) this.listener.click(at);
  }

  private redraw(): void {
    cancelAnimationFrame(this.frame);
    this.frame = requestAnimationFrame(() => this.draw());
  }

  private draw(): void {
    const { element, shown, viewport } = this;
    const paper = element.getContext("2d");
    if (!paper || !shown) return;
    const ratio = window.devicePixelRatio || 1;
    const [width, height] = this.room;
    if (element.width !== Math.round(width * ratio)) element.width = Math.round(width * ratio);
    if (element.height !== Math.round(height * ratio)) element.height = Math.round(height * ratio);
    paper.setTransform(ratio, 0, 0, ratio, 0, 0);
    paper.clearRect(0, 0, width, height);
    paper.imageSmoothingEnabled = viewport.scale < SHARP_FROM;
    paper.imageSmoothingQuality = "high";
    const { scale, left, top } = viewport;
    paper.drawImage(shown, left, top, shown.width * scale, shown.height * scale);
    drawOverlay(paper, viewport, this.overlay);
    if (element.matches(":focus-visible")) drawMiddle(paper, width / 2, height / 2);
  }
}

/** Picks the middle, for Enter. */
function drawMiddle(paper: CanvasRenderingContext2D, x: number, y: number): void {
  const arms = new Path2D(
    `M${x - 12} ${y}H${x - 3}M${x + 3} ${y}H${x + 12}M${x} ${y - 12}V${y - 3}M${x} ${y + 3}V${y + 12}`,
  );
  for (const [colour, width] of [
    ["#000", 3],
    ["#fff", 1],
  ] as const) {
    paper.strokeStyle = colour;
    paper.lineWidth = width;
    paper.stroke(arms);
  }
}

const KEYS: Readonly<Record<string, (view: ImageCanvas) => void>> = {
  ArrowLeft: (view) => view.step(1, 0),
  ArrowRight: (view) => view.step(-1, 0),
  ArrowUp: (view) => view.step(0, 1),
  ArrowDown: (view) => view.step(0, -1),
  "+": (view) => view.zoom(1.5),
  "-": (view) => view.zoom(1 / 1.5),
  "0": (view) => view.fit(),
  Enter: (view) => view.pickMiddle(),
};
