/** One stereo pair, looked at with both eyes: its canvas, its controls, pointer and keys. */

import { h } from "../../page/dom";
import { scopeTitle } from "../../page/format";
import { loadPairImages } from "../../server/stereo";
import type { Waiting } from "../../session/waiting";
import { StereoDisplay, type Way } from "./stereo-display";
import { moved, type Pair, type Sight, whole, zoomed } from "./fuse";
import "./stereo.css";

const WAYS: readonly (readonly [Way, string])[] = [
  ["anaglyph", "red and cyan"],
  ["parallel", "side by side"],
  ["crossed", "side by side, eyes crossed"],
  ["wiggle", "one after the other"],
];
const TURN_MS = 180;
const STEP = 1.25;

const titleOf = ({ left }: Pair) => `${left.id} · ${scopeTitle(left.stop)} · sol ${left.sol}`;

export class StereoView {
  readonly element: HTMLElement;
  private readonly canvas = h("canvas", { tabindex: 0, role: "img" });
  private readonly host = h("div", { class: "stereo-view" }, this.canvas);
  private readonly status = h("output", { class: "hint" });
  private readonly choice: HTMLSelectElement;
  private readonly slider: HTMLInputElement;
  private readonly shift = h("output", { class: "number" });
  private readonly closing = new AbortController();
  private readonly resized = new ResizeObserver(() => this.fit());
  private display: StereoDisplay | null = null;
  private sight: Sight = { scale: 1, x: 0, y: 0 };
  private way: Way = "anaglyph";
  private nudge = 0;
  private phase: 0 | 1 = 0;
  private timer: ReturnType<typeof setInterval> | undefined;

  constructor(
    private readonly pairs: readonly Pair[],
    private readonly waiting: Waiting,
    private readonly shown: (pair: Pair) => void,
  ) {
    const choose = () => this.show(pairs[Number(this.choice.value)]);
    this.choice = h("select", { "aria-label": "pair", name: "pair", onchange: choose });
    this.choice.append(...pairs.map((pair, k) => h("option", { value: k }, titleOf(pair))));
    const way = h(
      "select",
      {
        "aria-label": "way of looking",
        name: "way",
        onchange: () => this.setWay(way.value as Way),
      },
      ...WAYS.map(([value, title]) => h("option", { value }, title)),
    );
    this.slider = h("input", {
      type: "range",
      name: "nudge",
      "aria-label": "parallax on the screen, pixels",
      oninput: () => this.put(Number(this.slider.value)),
    });
    const full = () => void this.element.requestFullscreen();
    this.element = h(
      "div",
      { class: "stereo", "data-settled": "false" },
      this.host,
      h(
        "div",
        { class: "stereo-controls" },
        this.choice,
        h(
          "div",
          { class: "inline" },
          way,
          h(
            "button",
            { type: "button", class: "plain", name: "full", onclick: full },
            "full screen",
          ),
        ),
        h("label", { class: "inline" }, "parallax on the screen", this.slider, this.shift),
        this.status,
      ),
    );
    this.resized.observe(this.host);
    this.listen();
  }

  show(pair: Pair | undefined): void {
    if (!pair) return;
    this.choice.value = String(this.pairs.indexOf(pair));
    this.shown(pair);
    this.element.dataset["settled"] = "false";
    this.canvas.setAttribute("aria-label", `stereo pair ${pair.left.id} and ${pair.right.id}`);
    this.waiting.run(async () => {
      const images = await loadPairImages(pair.left, pair.right, this.closing.signal);
      this.display?.dispose();
      this.display = new StereoDisplay(images);
      this.open(this.display);
    });
  }

  dispose(): void {
    clearInterval(this.timer);
    this.closing.abort();
    this.resized.disconnect();
    this.display?.dispose();
  }

  private open(display: StereoDisplay): void {
    const most = Math.round(display.width / 2);
    Object.assign(this.slider, { min: String(-most), max: String(most), step: "1" });
    this.status.textContent = display.isLinearised
      ? "Rows correspond exactly. Arrow keys: parallax; plus and minus, wheel: nearer; drag: move."
      : "This pair was not matched: its images are not epipolar, rows may differ.";
    this.fit();
    this.put(display.parallax);
    this.element.dataset["settled"] = "true";
  }

  /** Places points of this parallax, in pixels, on the screen plane. */
  private put(nudge: number): void {
    this.nudge = nudge;
    this.slider.value = String(nudge);
    this.shift.textContent = `${nudge} px`;
    this.draw();
  }

  private setWay(way: Way): void {
    this.way = way;
    clearInterval(this.timer);
    if (way === "wiggle")
      this.timer = setInterval(() => {
        this.phase = this.phase ? 0 : 1;
        this.draw();
      }, TURN_MS);
    this.fit();
  }

  private get pixelRatio(): number {
    return Math.min(devicePixelRatio, 2);
  }

  private fit(): void {
    const { clientWidth, clientHeight } = this.host;
    if (!this.display || clientWidth === 0 || clientHeight === 0) return;
    this.canvas.width = Math.round(clientWidth * this.pixelRatio);
    this.canvas.height = Math.round(clientHeight * this.pixelRatio);
    const { width, height } = this.canvas;
    const isHalved = this.way === "parallel" || this.way === "crossed";
    this.sight = whole(
      this.display.width,
      this.display.height,
      isHalved ? width / 2 : width,
      height,
    );
    this.draw();
  }

  private draw(): void {
    this.display?.draw(this.canvas, this.way, this.sight, this.nudge, this.phase);
  }

  private see(sight: Sight): void {
    this.sight = sight;
    this.draw();
  }

  private listen(): void {
    const { signal } = this.closing;
    const { canvas } = this;
    const wheel = (event: WheelEvent) => {
      event.preventDefault();
      const dx = (event.offsetX - canvas.clientWidth / 2) * this.pixelRatio;
      const dy = (event.offsetY - canvas.clientHeight / 2) * this.pixelRatio;
      this.see(zoomed(this.sight, Math.exp(-event.deltaY / 400), dx, dy));
    };
    const drag = ({ buttons, movementX, movementY }: PointerEvent) => {
      const ratio = this.pixelRatio;
      if (buttons & 1) this.see(moved(this.sight, movementX * ratio, movementY * ratio));
    };
    canvas.addEventListener("wheel", wheel, { signal, passive: false });
    canvas.addEventListener("pointermove", drag, { signal });
    canvas.addEventListener("keydown", (event) => this.key(event), { signal });
  }

  private key(event: KeyboardEvent): void {
    const step = event.shiftKey ? 10 : 1;
    if (event.key === "ArrowLeft") this.put(this.nudge - step);
    else if (event.key === "ArrowRight") this.put(this.nudge + step);
    else if (event.key === "+") this.see(zoomed(this.sight, STEP, 0, 0));
    else if (event.key === "-") this.see(zoomed(this.sight, 1 / STEP, 0, 0));
    else return;
    event.preventDefault();
    event.stopPropagation();
  }
}
