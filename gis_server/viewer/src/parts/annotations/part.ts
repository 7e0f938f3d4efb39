/** Notes on the map: a place, line or area is drawn, a text written; everybody sees it, and it can be taken back. */

import "./annotations.css";
import type Feature from "ol/Feature";
import type Geometry from "ol/geom/Geometry";
import OlVectorLayer from "ol/layer/Vector";
import VectorSource from "ol/source/Vector";
import { Sketch, type Shape } from "../../map/sketch";
import { h } from "../../page/dom";
import { readFeatures } from "../../map/map-layers";
import { mayAct } from "../../server/account";
import { type AnnotationFeature, edits } from "../../server/edits";
import type { MapPoint } from "../../server/records";
import type { Context } from "../../session/context";
import { drawAnnotation } from "./drawing";
import { geometryOf } from "./geometry";
import { annotationsPanel } from "./panel";

const Z_INDEX = 990;

export function annotationsPart(context: Context): void {
  const annotations = new Annotations(context);
  const { account, signals, waiting, keys, mission, places } = context;
  account.changed.on(() => annotations.draw());
  places.add({
    title: "Add note",
    run: (point) => annotations.write("point", [point]),
    isOffered: () => mayAct(account.value, "analyst"),
  });
  keys.add("Escape", "stop drawing a note", () => annotations.stop());
  signals.happened.on(({ kind, document }) => {
    const concerns = kind === "edits.changed" && document.mission === mission.mission;
    if (concerns || kind === "reload") waiting.run(() => annotations.load());
  });
  waiting.run(() => annotations.load());
}

class Annotations {
  private readonly source = new VectorSource<Feature<Geometry>>();
  private readonly panel: HTMLElement;
  private all: readonly AnnotationFeature[] = [];
  private sketch: Sketch | null = null;

  constructor(private readonly context: Context) {
    this.panel = context.page.addTab("notes", "Notes");
    const { source } = this;
    const layer = new OlVectorLayer({ source, style: drawAnnotation, zIndex: Z_INDEX });
    context.view.map.addLayer(layer);
    this.draw();
  }

  async load(): Promise<void> {
    const { features } = await edits.annotations(this.context.mission.mission);
    this.all = features;
    this.source.clear();
    this.source.addFeatures(readFeatures({ type: "FeatureCollection", features }));
    this.draw();
  }

  draw(): void {
    const { account, view } = this.context;
    this.panel.replaceChildren(
      annotationsPanel(this.all, mayAct(account.value, "analyst"), {
        start: (shape) => this.start(shape),
        zoomTo: (id) => {
          const extent = this.source.getFeatureById(id)?.getGeometry()?.getExtent();
          const [west = 0, south = 0, east = 0, north = 0] = extent ?? [];
          if (extent) view.fit([west - 2, south - 2, east + 2, north + 2]);
        },
        takeBack: (id) => this.takeBack(id),
      }),
    );
  }

  start(shape: Shape): void {
    this.stop();
    const { view, page } = this.context;
    page.ruler.hidden = false;
    page.ruler.textContent =
      "draw the note's place on the map; double-click or Enter ends, Esc stops";
    this.sketch = new Sketch(view, shape, { end: (corners) => this.write(shape, corners) });
  }

  stop(): void {
    if (!this.sketch) return;
    this.sketch.stop();
    this.sketch = null;
    this.context.page.ruler.hidden = true;
  }

  /** Asks for the text of a note at a place, line or area. */
  write(shape: Shape, corners: readonly MapPoint[]): void {
    this.stop();
    const { page, waiting, mission } = this.context;
    const field = h("textarea", {
      rows: 3,
      required: true,
      maxlength: 4000,
      "aria-label": "text of the note",
    });
    const save = () =>
      waiting.run(async () => {
        await edits.annotate(mission.mission, {
          geometry: geometryOf(shape, corners),
          text: field.value.trim(),
        });
        await this.load();
      });
    const form = h(
      "form",
      {
        class: "note-form",
        onsubmit: (event) => {
          event.preventDefault();
          page.closeDialog();
          save();
        },
      },
      field,
      h("button", { type: "submit", class: "primary" }, "Save"),
    );
    page.dialog("Note", form);
    field.focus();
  }

  private takeBack(id: string): void {
    const { waiting, mission, page } = this.context;
    waiting.run(async () => {
      await edits.undo(mission.mission, Number(id));
      await this.load();
      page.toast("The note was taken back; it stays in the log.");
    });
  }
}
