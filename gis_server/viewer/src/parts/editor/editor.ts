/**
 * The tie-point editor: a feature is picked in images of two stops, measured, planned as a tie, previewed in an
 * adjustment of both stops, and saved for the next run. It joins the paper's projection, overlay and anaglyph tools.
 */

import "./editor.css";
import { h } from "../../page/dom";
import { mayAct } from "../../server/account";
import { type Edit, edits } from "../../server/edits";
import { projection } from "../../server/projection";
import type { ImageEntry, MapPoint } from "../../server/records";
import { type Predicted, ties } from "../../server/ties";
import type { Context } from "../../session/context";
import type { ImagePoint } from "../../image/viewport";
import {
  type Draft,
  EMPTY,
  pixel,
  planned,
  tieRequests,
  requestOf,
  withFirst,
  withMeasured,
  without,
  withSecond,
} from "./draft";
import { loadMosaic } from "../../map/mosaic";
import { OrthoOverlay } from "./ortho-overlay";
import { Pane } from "./pane";
import { editorPanel } from "./panel";

/** Nine in ten points lie within the standard ellipse enlarged by this factor. */
const ELLIPSE_90 = 2.146;

export class Editor {
  readonly element: HTMLElement;
  private readonly panes = h("div", { class: "editor-panes" });
  private readonly strip = h("div", { class: "editor-strip" });
  private readonly first: Pane;
  private readonly second: Pane;
  private draft: Draft = EMPTY;
  private saved: readonly Edit[] = [];
  private status =
    "Pick a feature in the left image; where it may lie in the other stop's images is shown on the right.";

  constructor(
    private readonly context: Context,
    images: readonly ImageEntry[],
    stops: readonly [string, string],
  ) {
    this.first = this.pane(images, stops[0], "first");
    this.second = this.pane(images, stops[1], "second");
    const tools = h(
      "div",
      { class: "editor-tools", role: "group", "aria-label": "tools" },
      h(
        "button",
        {
          type: "button",
          class: "text",
          "data-tool": "projection",
          onclick: () => this.showImages(),
        },
        "Images",
      ),
      h(
        "button",
        {
          type: "button",
          class: "text",
          "data-tool": "overlay",
          onclick: () => this.run(() => this.showOverlay()),
        },
        "Orthophotos",
      ),
    );
    this.element = h("div", { class: "editor" }, tools, this.panes, this.strip);
    this.showImages();
    this.redraw();
  }

  async start(): Promise<void> {
    await Promise.all([this.first.showFirst(), this.second.showFirst(), this.loadSaved()]);
  }

  async loadSaved(): Promise<void> {
    this.saved = await edits.ties(this.mission);
    this.redraw();
  }

  redraw(): void {
    const { account } = this.context;
    const actions = {
      refine: () => this.run(() => this.refine()),
      plan: () => this.plan(),
      drop: (row: number) => this.set(without(this.draft, row)),
      trial: () => this.run(() => this.trial()),
      save: () => this.run(() => this.save()),
      undo: (id: number) => this.run(() => this.undo(id)),
    };
    const mayWrite = mayAct(account.value, "analyst");
    this.strip.replaceChildren(editorPanel(this.draft, this.saved, mayWrite, this.status, actions));
  }

  private get mission(): string {
    return this.context.mission.mission;
  }

  private run(work: () => Promise<void>): void {
    this.context.waiting.act(work);
  }

  private pane(images: readonly ImageEntry[], stop: string, name: "first" | "second"): Pane {
    const forget = () => this.set({ ...this.draft, first: null, second: null });
    const pane: Pane = new Pane(images, stop, name, {
      stopChosen: () => {
        forget();
        this.run(() => pane.showFirst());
      },
      imageChosen: name === "first" ? forget : () => undefined,
      picked: (point) => this.picked(name, point),
      run: (work) => this.run(work),
    });
    return pane;
  }

  private set(draft: Draft, status = this.status): void {
    this.draft = draft;
    this.status = status;
    const place = (pick: Draft["first"], pane: Pane): readonly ImagePoint[] =>
      pick && pick.image === pane.image ? [[pick.sample, pick.line]] : [];
    this.first.draw({ picks: place(draft.first, this.first) });
    this.second.draw({ picks: place(draft.second, this.second) });
    this.redraw();
  }

  private picked(name: "first" | "second", [sample, line]: ImagePoint): void {
    if (name === "second") {
      const pick = { image: this.second.image, sample, line };
      this.set(
        withSecond(this.draft, pick),
        "Measure the point to a fraction of a pixel, or take it as it is.",
      );
      return;
    }
    this.set(withFirst(this.draft, { image: this.first.image, sample, line }));
    this.run(() => this.predict());
  }

  /** Shows where the first pick may lie in the images of the second stop. */
  private async predict(): Promise<void> {
    const { first } = this.draft;
    if (!first) return;
    const found = await ties.predict(this.mission, first, this.second.stop);
    const [best] = found.images.filter(({ eye }) => eye === "left");
    if (best) await this.showPredicted(best);
    else await this.showCurve(found.curves);
  }

  private async showPredicted(best: Predicted): Promise<void> {
    await this.second.show(best.image);
    const { ellipse, sight, epipolar } = best;
    const point: ImagePoint = [best.sample, best.line];
    const grown = {
      ...ellipse,
      semi_major_px: ELLIPSE_90 * ellipse.semi_major_px,
      semi_minor_px: ELLIPSE_90 * ellipse.semi_minor_px,
    };
    this.second.draw({
      cross: { point, ellipse: grown, sight },
      curve: epipolar.map(({ sample, line }): ImagePoint => [sample, line]),
    });
    this.second.element.dataset["predicted"] = point.join(",");
    this.second.centre(point);
    const seen =
      sight === "hidden" ? "other ground hides it there" : "nine in ten lie in the ellipse";
    this.set(this.draft, `Expected in ${best.image}: ${seen}; pick it there.`);
  }

  private async showCurve(
    curves: Readonly<Record<string, readonly { sample: number; line: number }[]>>,
  ) {
    const known = Object.entries(curves).find(([, points]) => points.length > 1);
    if (!known) {
      this.set(this.draft, "No image of the other stop shows this place.");
      return;
    }
    const [image, points] = known;
    await this.second.show(image);
    this.second.draw({
      cross: null,
      curve: points.map(({ sample, line }): ImagePoint => [sample, line]),
    });
    this.set(
      this.draft,
      `How far away the place is, is not known: it lies on the line in ${image}.`,
    );
  }

  private async refine(): Promise<void> {
    const { first, second } = this.draft;
    if (!first || !second) return;
    const found = await ties.refine(this.mission, pixel(first), pixel(second));
    const status = found.found
      ? `Measured ${found.moved_px.toFixed(2)} px from the pick, correlation ${(found.correlation ?? 0).toFixed(2)}.`
      : `Not measured: ${found.said ?? "it was not found"}. The pick stays as it is.`;
    this.set(withMeasured(this.draft, found), status);
  }

  private plan(): void {
    this.second.draw({ cross: null, curve: [] });
    this.set(planned(this.draft), "Try the planned ties on both stops, or pick the next feature.");
  }

  private async trial(): Promise<void> {
    const trial = await ties.trial(this.mission, tieRequests(this.draft));
    this.set({ ...this.draft, trial });
  }

  private async save(): Promise<void> {
    for (const { first, second, sigma_px } of this.draft.planned.map(requestOf)) {
      await edits.addTie(this.mission, {
        action: "add",
        first_image: first.image,
        first_sample: first.sample,
        first_line: first.line,
        second_image: second.image,
        second_sample: second.sample,
        second_line: second.line,
        ...(sigma_px === undefined ? {} : { sigma_px }),
        note: "tie-point editor",
      });
    }
    this.set(EMPTY, "Saved: the next run adjusts with these ties, and the map follows by itself.");
    await this.loadSaved();
  }

  private async undo(id: number): Promise<void> {
    await edits.undo(this.mission, id);
    await this.loadSaved();
  }

  private showImages(): void {
    this.panes.replaceChildren(this.first.element, this.second.element);
  }

  private async showOverlay(): Promise<void> {
    const { layers, mission } = this.context;
    const of = (stop: string) =>
      layers.of("orthophoto").find((layer) => layer.scope === stop && layer.type === "raster");
    const [one, other] = [of(this.first.stop), of(this.second.stop)];
    if (one?.type !== "raster" || other?.type !== "raster") {
      this.set(this.draft, "One of these stops has no orthophoto.");
      return;
    }
    const set = mission.tile_matrix_set;
    const [still, moved] = await Promise.all([loadMosaic(one, set), loadMosaic(other, set)]);
    const overlay = new OrthoOverlay(still, moved, (a, b) => this.run(() => this.pickGround(a, b)));
    this.panes.replaceChildren(overlay.element);
  }

  /** A feature of both orthophotos becomes a pick in an image of either stop. */
  private async pickGround(inFirst: MapPoint, inSecond: MapPoint): Promise<void> {
    const [one, other] = await Promise.all([
      this.seenFrom(this.first.stop, inFirst),
      this.seenFrom(this.second.stop, inSecond),
    ]);
    if (!one || !other) {
      this.set(this.draft, "One of the stops has no image of this place.");
      return;
    }
    this.showImages();
    await Promise.all([this.first.show(one.image), this.second.show(other.image)]);
    this.set(
      withSecond(withFirst(this.draft, one), other),
      "Picked in both; measure it, or pick it better.",
    );
    this.first.centre([one.sample, one.line]);
    this.second.centre([other.sample, other.line]);
  }

  private async seenFrom(stop: string, place: MapPoint) {
    const { images } = await projection.toImages(this.mission, place);
    return (
      images.find((seen) => seen.stop === stop && seen.eye === "left" && seen.sight !== "hidden") ??
      null
    );
  }
}
