/** One stereo pair for both eyes: its canvas, its controls, pointer and keys, and the shared cursor. */

import { h } from "../../page/dom";
import { scopeTitle } from "../../page/format";
import { projection } from "../../server/projection";
import type { MapPoint } from "../../server/records";
import { loadPairImages } from "../../server/stereo";
import { type Context, identify } from "../../session/context";
import { Latest } from "../../session/latest";
import type { StereoSight } from "../../session/state";
import { type Crosses, StereoDisplay, type Way } from "./stereo-display";
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
const REST_MS = 90;
const CLICK_PX = 4;

const titleOf = ({ left }: Pair) => `${left.id} · ${scopeTitle(left.stop)} · sol ${left.sol}`;

export class StereoView {
  readonly element: HTMLElement;
  private readonly canvas = h("canvas", { tabindex: 0, role: "img" });
  private readonly host = h("div", { class: "stereo-view" }, this.canvas);
  private readonly status = h("output");
  private readonly choice: HTMLSelectElement;
  private readonly ways: HTMLSelectElement;
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
  private pair: Pair | null = null;
  private isWhole = true;
  private crosses: Crosses = [null, null];
  private readonly queries: Latest;
  private isPointing = false;

  constructor(
    private readonly context: Context,
    private readonly pairs: readonly Pair[],
    /** The left image of the pair that is shown by default. */
    private readonly first: () => string | undefined,
    private readonly write: (value: StereoSight) => void,
  ) {
    this.queries = new Latest(REST_MS, (reason) => context.waiting.fail(reason));
    const choose = () => {
      const left = pairs[Number(this.choice.value)]?.left.id ?? "";
      this.show({ left, way: this.way, parallax: null, sight: null });
      this.update();
    };
    this.choice = h("select", { "aria-label": "pair", name: "pair", onchange: choose });
    this.choice.append(...pairs.map((pair, k) => h("option", { value: k }, titleOf(pair))));
    this.ways = h(
      "select",
      {
        "aria-label": "display mode",
        name: "way",
        onchange: () => {
          this.setWay(this.ways.value as Way);
          this.update();
        },
      },
      ...WAYS.map(([value, title]) => h("option", { value }, title)),
    );
    this.slider = h("input", {
      type: "range",
      name: "nudge",
      "aria-label": "parallax on the screen, pixels",
      oninput: () => {
        this.put(Number(this.slider.value));
        this.update();
      },
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
          this.ways,
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

  show({ left, way, parallax, sight }: StereoSight): void {
    const requested = left || this.first();
    const pair = this.pairs.find((one) => one.left.id === requested) ?? this.pairs[0];
    if (!pair) return;
    this.ways.value = way;
    const place = () => {
      this.isWhole = sight === null;
      if (sight)
        this.sight = { scale: sight.scale * this.pixelRatio, x: sight.sample, y: sight.line };
      this.setWay(way);
      this.put(parallax ?? this.display?.parallax ?? 0);
    };
    if (pair === this.pair) {
      place();
      return;
    }
    this.pair = pair;
    this.crosses = [null, null];
    this.choice.value = String(this.pairs.indexOf(pair));
    this.element.dataset["settled"] = "false";
    this.canvas.setAttribute("aria-label", `stereo pair ${pair.left.id} and ${pair.right.id}`);
    this.context.waiting.run(async () => {
      const images = await loadPairImages(pair.left, pair.right, this.closing.signal);
      if (pair !== this.pair) return;
      this.display?.dispose();
      this.display = new StereoDisplay(images);
      this.open(this.display);
      place();
      this.update();
      this.element.dataset["settled"] = "true";
    });
  }

  dispose(): void {
    clearInterval(this.timer);
    this.queries.stop();
    this.closing.abort();
    this.resized.disconnect();
    this.display?.dispose();
    this.context.events.cursor.emit(null);
  }

  private open(display: StereoDisplay): void {
    const most = Math.round(display.width / 2);
    Object.assign(this.slider, { min: String(-most), max: String(most), step: "1" });
    this.status.className = display.isLinearised ? "hint" : "";
    this.status.textContent = display.isLinearised
      ? "Rows correspond exactly. Arrow keys: parallax; plus and minus, wheel: nearer; drag: move."
      : "This pair was not matched: its images are not epipolar, rows may differ.";
  }

  /** Records what is seen in the link, except the parallax and the part that are shown at first. */
  private update(): void {
    const { pair, display, way, nudge, isWhole } = this;
    if (!pair || !display) return;
    const { scale, x, y } = this.sight;
    this.write({
      left: pair.left.id,
      way,
      parallax: nudge === display.parallax ? null : nudge,
      sight: isWhole ? null : { scale: scale / this.pixelRatio, sample: x, line: y },
    });
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
    if (this.isWhole)
      this.sight = whole(this.display.width, this.display.height, width / this.halves, height);
    this.draw();
  }

  /** Images beside each other on the canvas. */
  private get halves(): number {
    return this.way === "parallel" || this.way === "crossed" ? 2 : 1;
  }

  private draw(): void {
    const { way, sight, nudge, phase, crosses } = this;
    this.display?.draw(this.canvas, way, sight, { nudge, phase, crosses });
  }

  private see(sight: Sight): void {
    this.sight = sight;
    this.isWhole = false;
    this.draw();
    this.update();
  }

  /** The pixel of the left image at a place of the canvas; null where that shows the other one. */
  private pixelAt({ offsetX, offsetY }: MouseEvent): readonly [number, number] | null {
    const { display, canvas, sight, way } = this;
    if (!display) return null;
    const width = canvas.clientWidth / this.halves;
    const left = way === "crossed" ? width : 0;
    const x = sight.x + ((offsetX - left - width / 2) * this.pixelRatio) / sight.scale - 0.5;
    const y = sight.y + ((offsetY - canvas.clientHeight / 2) * this.pixelRatio) / sight.scale - 0.5;
    const isOn = offsetX >= left && offsetX < left + width;
    return isOn && x >= -0.5 && y >= -0.5 && x < display.width && y < display.height
      ? [x, y]
      : null;
  }

  /** The ground at a pixel of the left image. */
  private async groundAt(at: readonly [number, number], signal?: AbortSignal) {
    const { pair, display, context } = this;
    if (!pair || !display) return null;
    const { mission } = context.mission;
    const { id } = pair.left;
    const pixel = display.isLinearised ? await projection.stored(id, at, signal) : at;
    const { ground } = await projection.toGround(mission, id, pixel, signal);
    return ground && ([ground.east, ground.north] as const);
  }

  private hover(event: MouseEvent | null): void {
    const at = event && this.pixelAt(event);
    this.isPointing = at !== null;
    if (at)
      this.queries.run(async (signal) => {
        const ground = await this.groundAt(at, signal);
        this.element.dataset["ground"] = ground?.join(",") ?? "";
        this.context.events.cursor.emit(ground);
      });
    else {
      this.queries.stop();
      this.context.events.cursor.emit(null);
    }
  }

  private click(event: MouseEvent): void {
    const at = this.pixelAt(event);
    if (at)
      this.context.waiting.run(async () => {
        const ground = await this.groundAt(at);
        if (ground) identify(this.context, ground);
      });
  }

  /** Marks a place of the map in both images. */
  private mark(point: MapPoint | null): void {
    if (this.isPointing) return;
    if (!point) this.queries.stop();
    else
      this.queries.run(async (signal) => {
        const { mission } = this.context.mission;
        const { images } = await projection.toImages(mission, point, signal);
        const { pair, display } = this;
        const at = (id: string | undefined) => {
          const seen = images.find(({ image }) => image === id);
          const [x, y] = display?.isLinearised
            ? [seen?.linearised_sample, seen?.linearised_line]
            : [seen?.sample, seen?.line];
          return typeof x === "number" && typeof y === "number" ? ([x, y] as const) : null;
        };
        this.crosses = [at(pair?.left.id), at(pair?.right.id)];
        this.element.dataset["crosses"] = this.crosses.map((one) => one?.join(",") ?? "").join(";");
        this.draw();
      });
  }

  private listen(): void {
    const { signal } = this.closing;
    const { canvas } = this;
    const { events } = this.context;
    let dragged = 0;
    const wheel = (event: WheelEvent) => {
      event.preventDefault();
      const dx = (event.offsetX - canvas.clientWidth / 2) * this.pixelRatio;
      const dy = (event.offsetY - canvas.clientHeight / 2) * this.pixelRatio;
      this.see(zoomed(this.sight, Math.exp(-event.deltaY / 400), dx, dy));
    };
    const drag = (event: PointerEvent) => {
      const { buttons, movementX, movementY } = event;
      const ratio = this.pixelRatio;
      if (!(buttons & 1)) {
        this.hover(event);
        return;
      }
      dragged += Math.hypot(movementX, movementY);
      if (dragged > CLICK_PX) this.see(moved(this.sight, movementX * ratio, movementY * ratio));
    };
    const stops = [
      events.pointer.on((pointed) => this.mark(pointed?.point ?? null)),
      events.cursor.on((point) => point && this.mark(point)),
    ];
    signal.addEventListener("abort", () => stops.forEach((stop) => stop()));
    canvas.addEventListener("pointerdown", () => (dragged = 0), { signal });
    canvas.addEventListener("pointerleave", () => this.hover(null), { signal });
    canvas.addEventListener("click", (event) => dragged <= CLICK_PX && this.click(event), {
      signal,
    });
    canvas.addEventListener("wheel", wheel, { signal, passive: false });
    canvas.addEventListener("pointermove", drag, { signal });
    canvas.addEventListener("keydown", (event) => this.key(event), { signal });
  }

  private key(event: KeyboardEvent): void {
    const step = event.shiftKey ? 10 : 1;
    if (event.key === "ArrowLeft" || event.key === "ArrowRight") {
      this.put(this.nudge + (event.key === "ArrowLeft" ? -step : step));
      this.update();
    } else if (event.key === "+") this.see(zoomed(this.sight, STEP, 0, 0));
    else if (event.key === "-") this.see(zoomed(this.sight, 1 / STEP, 0, 0));
    else return;
    event.preventDefault();
    event.stopPropagation();
  }
}
