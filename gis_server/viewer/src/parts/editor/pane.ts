/** One side of the editor: a stop, its left images, and the one for picking points. */

import { h } from "../../page/dom";
import { scopeTitle } from "../../page/format";
import type { ImageEntry } from "../../server/records";
import type { Overlay } from "../../image/overlay";
import { ImageCanvas } from "../../image/image-canvas";
import type { ImagePoint } from "../../image/viewport";
import { anaglyphUrl } from "./anaglyph";

const LARGEST_NUDGE = 80;
const PICK_SCALE = 4;

export interface PaneListener {
  readonly stopChosen: () => void;
  readonly imageChosen: () => void;
  readonly picked: (point: ImagePoint) => void;
  /** Runs what needs the server. */
  readonly run: (work: () => Promise<void>) => void;
}

export class Pane {
  readonly element: HTMLElement;
  private readonly stops: HTMLSelectElement;
  private readonly images = h("select", { "aria-label": "image" });
  private readonly stereo = h("input", { type: "checkbox" });
  private readonly nudge = h("input", {
    type: "range",
    min: 0,
    max: LARGEST_NUDGE,
    value: 10,
    "aria-label": "parallax of the anaglyph",
  });
  private readonly imageCanvas: ImageCanvas;
  private current: ImageEntry | null = null;

  constructor(
    private readonly all: readonly ImageEntry[],
    first: string,
    readonly name: "first" | "second",
    private readonly listener: PaneListener,
  ) {
    this.imageCanvas = new ImageCanvas({
      hover: () => undefined,
      click: (point) => listener.picked(point),
      moved: () => undefined,
    });
    const names = [...new Set(all.map(({ stop }) => stop))];
    this.stops = h(
      "select",
      { "aria-label": `${name} stop`, onchange: () => this.stopChosen() },
      ...names.map((stop) =>
        h("option", { value: stop, selected: stop === first }, scopeTitle(stop)),
      ),
    );
    this.images.addEventListener("change", () => {
      this.listener.run(() => this.show(this.images.value));
      this.listener.imageChosen();
    });
    const redraw = () => this.listener.run(() => this.load());
    this.stereo.addEventListener("change", redraw);
    this.nudge.addEventListener("change", redraw);
    this.element = h(
      "section",
      { class: "pane", "data-pane": name },
      h(
        "div",
        { class: "pane-head" },
        this.stops,
        this.images,
        h("label", { class: "inline" }, this.stereo, "anaglyph"),
        this.nudge,
      ),
      this.imageCanvas.element,
    );
    this.fillImages();
  }

  get stop(): string {
    return this.stops.value;
  }

  get image(): string {
    return this.current?.id ?? this.images.value;
  }

  /** Shows an image of this stop, whole; nothing happens if it is shown already. */
  async show(id: string): Promise<void> {
    if (this.current?.id === id) return;
    const entry = this.all.find((image) => image.id === id && image.stop === this.stop);
    if (!entry) return;
    this.current = entry;
    this.images.value = id;
    this.element.dataset["image"] = id;
    this.draw({ cross: null, curve: [], picks: [] });
    await this.load();
  }

  async showFirst(): Promise<void> {
    await this.show(this.images.value);
  }

  draw(overlay: Partial<Overlay>): void {
    this.imageCanvas.put(overlay);
    const pick = overlay.picks?.[0];
    if (overlay.picks) this.element.dataset["pick"] = pick ? pick.join(",") : "";
  }

  /** Brings a point into the middle, so large that its pixels are seen. */
  centre(point: ImagePoint): void {
    this.imageCanvas.centre(point, PICK_SCALE);
  }

  private stopChosen(): void {
    this.fillImages();
    this.listener.stopChosen();
  }

  private fillImages(): void {
    const mine = this.all.filter(({ stop }) => stop === this.stop);
    this.images.replaceChildren(
      ...mine.map(({ id, sol }) => h("option", { value: id }, `${id} (sol ${sol})`)),
    );
    this.current = null;
  }

  private async load(): Promise<void> {
    const { current } = this;
    if (!current?.browse) return;
    const partner = current.partner && `images/${current.partner}/browse.png`;
    if (!this.stereo.checked || !partner) {
      await this.imageCanvas.load(current.browse, current.id);
      return;
    }
    const url = await anaglyphUrl(current.browse, partner, Number(this.nudge.value));
    await this.imageCanvas.load(url, `${current.id} and its partner, for red and cyan glasses`);
    URL.revokeObjectURL(url);
  }
}
