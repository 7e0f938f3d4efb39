/** One image in its pane: its pixels, its ties, and the place marked both on the map and in the image. */

import { h } from "../../page/dom";
import { fixed, HELD_M, measured } from "../../page/format";
import { type ImageTie, network } from "../../server/network";
import { type ImageToGround, projection, type Seen } from "../../server/projection";
import type { ImageEntry, MapPoint } from "../../server/records";
import { type Context, identify, openImage } from "../../session/context";
import type { ImageSight } from "../../session/state";
import { isRefusal, Latest } from "../../session/latest";
import { type Controls, controls } from "./controls";
import { tieAt, tieText } from "../../image/overlay";
import { ImageCanvas } from "../../image/image-canvas";
import { Strip } from "./strip";
import { percentileStretch } from "../../image/stretch";
import type { ImagePoint, ScreenPoint } from "../../image/viewport";

const REST_MS = 90;

export class ImageViewer {
  readonly element: HTMLElement;
  private readonly imageCanvas: ImageCanvas;
  private readonly tools: Controls;
  private readonly strip: Strip;
  private readonly status = h("p", { class: "image-status", role: "status" });
  private readonly queries: Latest;
  private image: ImageEntry | null = null;
  private ties: readonly ImageTie[] = [];
  private isPointing = false;
  private isLoaded = false;

  constructor(
    private readonly context: Context,
    private readonly write: (value: { id: string; sight: ImageSight | null }) => void,
  ) {
    const { waiting } = context;
    this.queries = new Latest(REST_MS, (reason) => waiting.fail(reason));
    this.imageCanvas = new ImageCanvas({
      hover: (at, screen) => this.hover(at, screen),
      click: (at) => this.click(at),
      moved: (sight) => this.moved(sight),
    });
    this.tools = controls({
      fit: () => this.imageCanvas.fit(),
      zoom: (factor) => this.imageCanvas.zoom(factor),
      stretch: (stretch) => this.imageCanvas.stretch(stretch),
      automatic: (share) => percentileStretch(this.imageCanvas.pixels, share),
      showTies: () => this.drawTies(),
      residualFactor: () => this.drawTies(),
    });
    this.strip = new Strip((id) => openImage(context, id));
    this.element = h(
      "div",
      { class: "image-view" },
      this.tools.element,
      this.imageCanvas.element,
      this.status,
      this.strip.element,
    );
    this.status.textContent = "";
  }

  /** Shows an image, unstretched; the whole where no part is given. */
  async open(image: ImageEntry, sight: ImageSight | null): Promise<void> {
    if (image.id === this.image?.id) {
      this.imageCanvas.look(sight);
      return;
    }
    this.image = image;
    this.isLoaded = false;
    this.element.dataset["image"] = image.id;
    this.ties = [];
    this.drawTies();
    this.imageCanvas.put({ cross: null });
    this.tools.reset();
    if (image.browse) await this.imageCanvas.load(image.browse, image.id, sight);
    if (this.image !== image) return; // another one was opened meanwhile
    this.isLoaded = true;
    await this.loadTies(image);
  }

  close(): void {
    this.queries.stop();
    this.image = null;
    this.context.events.cursor.emit(null);
  }

  /** Marks a place of the map in the image, and in all that show it. */
  mark(point: MapPoint | null): void {
    if (this.isPointing || !this.image) return;
    if (!point) {
      this.queries.stop();
      return;
    }
    const { mission } = this.context.mission;
    this.queries.run(async (signal) => {
      const { images } = await projection.toImages(mission, point, signal);
      this.showSeen(images);
    });
  }

  private showSeen(images: readonly Seen[]): void {
    const { image } = this;
    const here = images.find((seen) => seen.image === image?.id);
    this.strip.show(images, image?.id ?? null);
    const cross = here
      ? { point: [here.sample, here.line] as const, ellipse: here.ellipse, sight: here.sight }
      : null;
    this.imageCanvas.put({ cross });
    this.element.dataset["cross"] = here ? `${here.sample},${here.line},${here.sight}` : "";
    this.status.textContent = here ? crossText(here) : "The place on the map is not in this image.";
  }

  private async loadTies(image: ImageEntry): Promise<void> {
    try {
      const { ties } = await network.ties(this.context.mission.mission, image.id);
      if (this.image?.id !== image.id) return;
      this.ties = ties;
    } catch (reason) {
      if (!isRefusal(reason)) throw reason; // an image outside the network has no ties
    }
    this.drawTies();
  }

  private drawTies(): void {
    const { hasTies, factor } = this.tools;
    this.imageCanvas.put({ ties: hasTies ? this.ties : [], residualFactor: factor });
    this.tools.showTieCount(` ${this.ties.length}`);
    this.element.dataset["ties"] = String(hasTies ? this.ties.length : 0);
  }

  /** Stores the visible part; null: the whole image, which fits any pane. */
  private moved(sight: ImageSight | null): void {
    this.element.dataset["scale"] = this.imageCanvas.viewport.scale.toFixed(4);
    if (this.image && this.isLoaded) this.write({ id: this.image.id, sight });
  }

  private hover(at: ImagePoint | null, screen: ScreenPoint): void {
    this.isPointing = at !== null;
    const { image } = this;
    if (!at || !image) {
      this.queries.stop();
      this.context.events.cursor.emit(null);
      return;
    }
    const tie = this.tools.hasTies ? tieAt(this.ties, this.imageCanvas.viewport, screen) : null;
    const start = `sample ${fixed(at[0], 1)}, line ${fixed(at[1], 1)}, grey ${this.imageCanvas.grey(at) ?? "–"}`;
    this.status.textContent = tie ? tieText(tie) : start;
    const { mission } = this.context.mission;
    this.queries.run(async (signal) => {
      const found = await projection.toGround(mission, image.id, at, signal);
      if (!tie) this.status.textContent = `${start}: ${groundText(found)}`;
      await this.followed(found, signal);
    });
  }

  /** The place on the map and in all other images, while the pointer is on this one. */
  private async followed({ ground }: ImageToGround, signal: AbortSignal): Promise<void> {
    const point: MapPoint | null = ground && [ground.east, ground.north];
    this.context.events.cursor.emit(point);
    if (!point) return;
    const { images } = await projection.toImages(this.context.mission.mission, point, signal);
    this.strip.show(images, this.image?.id ?? null);
  }

  private click(at: ImagePoint): void {
    const { image } = this;
    if (!image) return;
    const { mission, waiting } = this.context;
    waiting.run(async () => {
      const { ground } = await projection.toGround(mission.mission, image.id, at);
      if (ground) identify(this.context, [ground.east, ground.north]);
      else waiting.notify("This pixel shows no ground that was mapped.");
    });
  }
}

export function groundText({ ground, told_by }: ImageToGround): string {
  if (!ground) return "no mapped ground";
  const one = (value: number, sigma: number) => measured(value, "m", sigma, HELD_M);
  const north = one(ground.north, ground.sigma_north_m);
  const east = one(ground.east, ground.sigma_east_m);
  const by = told_by === "parallax" ? "matched" : "on the terrain";
  return `N ${north}, E ${east}, up ${one(ground.elevation_m, ground.sigma_up_m)} (${by})`;
}

export function crossText({ sample, line, sight, range_m, told_by }: Seen): string {
  const place = `sample ${fixed(sample, 1)}, line ${fixed(line, 1)}, ${measured(range_m, "m", null, 0.1)} away`;
  switch (sight) {
    case "visible":
      return `The place on the map: ${place}.`;
    case "hidden":
      return `Occluded (${told_by}): the place would be at ${place}, but other ground hides it.`;
    default:
      return `The place on the map: ${place}; its visibility is not known.`;
  }
}
