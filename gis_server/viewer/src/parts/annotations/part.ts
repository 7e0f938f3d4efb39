/** Annotations: points, lines and polygons with a category and a text, which everybody sees. */

import "./annotations.css";
import type Feature from "ol/Feature";
import type Geometry from "ol/geom/Geometry";
import OlVectorLayer from "ol/layer/Vector";
import VectorSource from "ol/source/Vector";
import { Sketch, type Shape } from "../../map/sketch";
import { readFeatures } from "../../map/map-layers";
import { mayAct } from "../../server/account";
import { UnreachableError } from "../../server/api";
import { type AnnotationEdit, type AnnotationFeature, edits } from "../../server/edits";
import type { MapPoint } from "../../server/records";
import type { Context } from "../../session/context";
import { drawAnnotation } from "./drawing";
import { annotationForm, type Filled } from "./form";
import { geometryOf, shapeOf } from "./geometry";
import { Outbox, type Unsent } from "./outbox";
import { annotationsPanel } from "./panel";

const Z_INDEX = 990;

export function annotationsPart(context: Context): void {
  const annotations = new Annotations(context);
  const { account, events, waiting, keys, mission, places, signal } = context;
  account.changed.on(() => {
    annotations.draw();
    annotations.send();
  });
  places.add({
    title: "Add annotation",
    run: (point) => annotations.write("point", [point], null),
    isOffered: () => mayAct(account.value, "analyst"),
  });
  keys.add("Escape", "stop drawing an annotation", () => annotations.stop());
  events.serverEvent.on(({ kind, document }) => {
    const concerns = kind === "edits.changed" && document.mission === mission.mission;
    if (concerns || kind === "reload") waiting.run(() => annotations.load());
  });
  events.reconnected.on(() => annotations.send());
  window.addEventListener("online", () => annotations.send(), { signal });
  waiting.run(() => annotations.load());
  annotations.send();
}

class Annotations {
  private readonly source = new VectorSource<Feature<Geometry>>();
  private readonly panel: HTMLElement;
  private readonly outbox: Outbox;
  private all: readonly AnnotationFeature[] = [];
  private sketch: Sketch | null = null;
  private isSending = false;

  constructor(private readonly context: Context) {
    this.panel = context.page.addTab("notes");
    this.outbox = new Outbox(context.mission.mission);
    const { source } = this;
    const layer = new OlVectorLayer({ source, style: drawAnnotation, zIndex: Z_INDEX });
    context.view.map.addLayer(layer);
    this.draw();
  }

  private get mayWrite(): boolean {
    return mayAct(this.context.account.value, "analyst");
  }

  async load(): Promise<void> {
    const { features } = await edits.annotations(this.context.mission.mission);
    this.all = features;
    this.draw();
  }

  draw(): void {
    const { view } = this.context;
    const unsent = this.outbox.all.map(({ key, annotation: { geometry, ...properties } }) => ({
      type: "Feature",
      id: key,
      geometry,
      properties,
    }));
    this.source.clear();
    const features = [...this.all, ...unsent];
    this.source.addFeatures(readFeatures({ type: "FeatureCollection", features }));
    this.panel.replaceChildren(
      annotationsPanel(this.all, this.outbox.all, this.mayWrite, {
        start: (shape) => this.start(shape, null),
        zoomTo: (id) => {
          const extent = this.source.getFeatureById(id)?.getGeometry()?.getExtent();
          const [west = 0, south = 0, east = 0, north = 0] = extent ?? [];
          if (extent) view.fit([west - 2, south - 2, east + 2, north + 2]);
        },
        edit: (note) =>
          this.openForm(note, (filled) => this.save({ ...filled, geometry: note.geometry }, note)),
        redraw: (note) => this.start(shapeOf(note.geometry), note),
        remove: ({ id }) =>
          this.undo(Number(id), "The annotation was deleted; the list below restores it."),
        restore: ({ deletion }) => this.undo(deletion.id, "The annotation is on the map again."),
        log: () => edits.log(this.context.mission.mission),
        send: () => this.send(),
        discard: (one) => {
          this.outbox.remove(one);
          this.draw();
        },
      }),
    );
  }

  /** Draws the geometry of a new annotation, or redraws that of an existing one. */
  start(shape: Shape, note: AnnotationFeature | null): void {
    this.stop();
    const { view, page } = this.context;
    page.ruler.hidden = false;
    page.ruler.textContent = "Click or Space sets a corner, Enter ends, Esc stops.";
    this.sketch = new Sketch(view, shape, { end: (corners) => this.write(shape, corners, note) });
  }

  stop(): void {
    if (!this.sketch) return;
    this.sketch.stop();
    this.sketch = null;
    this.context.page.ruler.hidden = true;
  }

  /** Opens the form for the text of a place, line or area; an existing annotation is only moved. */
  write(shape: Shape, corners: readonly MapPoint[], note: AnnotationFeature | null): void {
    this.stop();
    const geometry = geometryOf(shape, corners);
    if (note) this.save({ ...filledOf(note), geometry }, note);
    else this.openForm(null, (filled) => this.save({ ...filled, geometry }, null));
  }

  private openForm(note: AnnotationFeature | null, save: (filled: Filled) => void): void {
    const { page } = this.context;
    const form = annotationForm(note && filledOf(note), (filled) => {
      page.closeDialog();
      save(filled);
    });
    page.dialog("Annotation", form);
    form.querySelector("textarea")?.focus();
  }

  /** Keeps it in the browser until the server has stored it. */
  private save(annotation: AnnotationEdit, replaced: AnnotationFeature | null): void {
    this.outbox.add({ ...annotation, ...(replaced ? { replaces: Number(replaced.id) } : {}) });
    this.draw();
    this.send();
  }

  /** Sends annotations that the server has not stored yet, one after the other. */
  send(): void {
    if (this.isSending || !this.mayWrite || this.outbox.all.length === 0) return;
    this.isSending = true;
    this.context.waiting.act(async () => {
      try {
        for (const one of this.outbox.all) await this.sendOne(one);
      } finally {
        this.isSending = false;
        this.draw();
      }
      await this.load();
    });
  }

  private async sendOne(one: Unsent): Promise<void> {
    const { mission, page } = this.context;
    try {
      await edits.annotate(mission.mission, one.annotation);
      this.outbox.remove(one);
    } catch (reason) {
      if (reason instanceof UnreachableError)
        page.toast("The server does not answer: the annotation is kept in this browser.");
      throw reason;
    }
  }

  private undo(edit: number, done: string): void {
    const { waiting, mission, page } = this.context;
    waiting.act(async () => {
      await edits.undo(mission.mission, edit);
      await this.load();
      page.toast(done);
    });
  }
}

const filledOf = ({ properties }: AnnotationFeature): Filled => ({
  text: properties.text,
  category: properties.category ?? "note",
  state: properties.state ?? "published",
});
