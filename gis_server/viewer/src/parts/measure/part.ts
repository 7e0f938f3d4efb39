/** Measuring on the map: a kind is chosen, a shape is drawn, and the server measures it on the ground. */

import "./measure.css";
import { kindTitle } from "../../map/layers";
import { isForMap, Sketch } from "../../map/sketch";
import { button, facts } from "../../page/dom";
import { scopeTitle } from "../../page/format";
import { saveFile } from "../../page/save";
import type { MapPoint } from "../../server/records";
import type { Context } from "../../session/context";
import { formatPoints, parsePoints } from "../../session/link-points";
import { orPlanar, withoutRepeats } from "./corners";
import { boundsOf, DrawnMeasurements } from "./drawn";
import { type Measurement, measurementsCsv, measurementsGeojson, profilesCsv } from "./export";
import { GroundProfile } from "./ground-profile";
import type { Found, Mode } from "./mode";
import { MODES } from "./modes";
import { ChosenNumbers } from "./numbers";
import { measurePanel } from "./panel";
import { quantityText } from "./quantities";

/** Of the measurements in the link: `distance:0,0;3,4/area:0,0;3,0;3,4`. */
const KEY = "measure";

/** The text about a line that was drawn elsewhere. */
const BETWEEN = ["straight, in space", "length on the map", "rise", "slope"];

export function measurePart(context: Context): void {
  const { page, keys, places, link, signals, alive } = context;
  const panel = page.addTab("measure", "Measure");
  const tool = button("measure (m)", "ruler", () => measuring.toggle(), {
    class: "measure",
    "aria-pressed": "false",
  });
  const measuring = new Measuring(context, panel, tool);
  page.addTool(tool);
  const [distance, viewshed] = ["distance", "viewshed"].map((key) =>
    MODES.find((mode) => mode.key === key),
  );
  if (distance)
    places.add({
      title: "Measure from here",
      run: (point) => measuring.start(distance, point),
    });
  if (distance) signals.measure.on(({ corners, box }) => measuring.between(distance, corners, box));
  if (viewshed)
    places.add({ title: "Viewshed from here", run: (point) => measuring.at(viewshed, point) });
  link.follow(KEY, (text) => measuring.restore(text ?? ""));
  keys.add("m", "measure a distance", () => measuring.toggle());
  keys.add("Escape", "stop measuring", () => measuring.stop());
  document.addEventListener("keydown", (event) => drawingKey(event, measuring), { signal: alive });
  alive.addEventListener("abort", () => measuring.dispose());
}

/** Enter and Backspace for places that are picked one by one; what is drawn has its own. */
function drawingKey(event: KeyboardEvent, measuring: Measuring): void {
  if (!isForMap(event)) return;
  if (event.key === "Enter") measuring.finish();
  if (event.key === "Backspace") measuring.undo();
}

class Measuring {
  private readonly drawn: DrawnMeasurements;
  private readonly profile: GroundProfile;
  private all: readonly Measurement[] = [];
  private mode: Mode | null = null;
  private sketch: Sketch | null = null;
  private picked: readonly MapPoint[] = [];
  private count = 0;
  private layer: string | null = null;
  private readonly numbers = new ChosenNumbers();

  constructor(
    private readonly context: Context,
    private readonly panel: HTMLElement,
    private readonly tool: HTMLElement,
  ) {
    this.drawn = new DrawnMeasurements(context.view.map);
    this.profile = new GroundProfile(context);
    this.draw();
  }

  toggle(): void {
    const [first] = MODES;
    if (this.mode) this.stop();
    else if (first) this.start(first);
  }

  /** Measures a kind that needs one place. */
  at(mode: Mode, point: MapPoint): void {
    this.stop();
    this.context.page.showTab("measure");
    this.find(mode, [point]);
  }

  /** Measures a line that was drawn elsewhere, and shows the result in a box. */
  between(mode: Mode, corners: readonly MapPoint[], box: HTMLElement): void {
    const { mission, waiting, link } = this.context;
    waiting.run(async () => {
      const asked = { layer: this.layer, numbers: this.numbers.of(mode) };
      const found = await orPlanar(mode, corners, mode.find(mission.mission, corners, asked));
      this.keep(mode, corners, found);
      link.write(KEY, this.linked);
      const between = found.quantities.filter(({ name }) => BETWEEN.includes(name));
      box.replaceChildren(facts(between.map((one) => [one.name, quantityText(one)] as const)));
      if (found.note) box.append(found.note);
    });
  }

  /** Begins to draw, at a place if one is given. */
  start(mode: Mode, from?: MapPoint): void {
    this.stop();
    this.mode = mode;
    const { page, view } = this.context;
    page.ruler.hidden = false;
    this.tool.setAttribute("aria-pressed", "true");
    this.tell([]);
    const end = (corners: readonly MapPoint[]) => this.ended(corners);
    const change = (corners: readonly MapPoint[]) => this.tell(corners);
    this.sketch = new Sketch(view, mode.shape, { change, end }, mode);
    if (from) this.sketch.begin(from);
    page.showTab("measure");
    this.draw();
  }

  stop(): void {
    if (!this.mode) return;
    this.sketch?.stop();
    this.sketch = null;
    this.mode = null;
    this.picked = [];
    this.context.page.ruler.hidden = true;
    this.tool.setAttribute("aria-pressed", "false");
    this.draw();
  }

  undo(): void {
    if (this.mode?.shape === "point") this.pick(this.picked.slice(0, -1));
  }

  finish(): void {
    if (this.mode?.shape !== "point" || this.picked.length < this.mode.least) return;
    const points = this.picked;
    this.pick([]);
    this.find(this.mode, points);
  }

  dispose(): void {
    this.sketch?.stop();
    this.drawn.dispose();
  }

  /** Measures what a link contains, and nothing else. */
  restore(text: string): void {
    if (text === this.linked) return;
    this.all = [];
    this.draw();
    const { mission, waiting, link } = this.context;
    const asked = text.split("/").map((one) => one.split(":"));
    waiting.run(async () => {
      for (const [key, places = ""] of asked) {
        const mode = MODES.find((one) => one.key === key);
        const corners = parsePoints(places);
        if (!mode || !corners || corners.length < mode.least) continue;
        const numbers = { layer: this.layer, numbers: this.numbers.of(mode) };
        this.keep(mode, corners, await mode.find(mission.mission, corners, numbers));
      }
      link.write(KEY, this.linked);
    });
  }

  private get linked(): string {
    return this.all.map(({ mode, corners }) => `${mode.key}:${formatPoints(corners)}`).join("/");
  }

  private keep(mode: Mode, corners: readonly MapPoint[], found: Found): Measurement {
    this.count += 1;
    const one = { number: this.count, mode, corners, found };
    this.all = [...this.all, one];
    this.draw();
    return one;
  }

  private tell(corners: readonly MapPoint[]): void {
    this.context.page.ruler.textContent = this.mode?.live(corners) ?? "";
  }

  private pick(points: readonly MapPoint[]): void {
    this.picked = points;
    this.tell(points);
    this.context.view.setPicked(points);
  }

  private ended(corners: readonly MapPoint[]): void {
    const { mode } = this;
    if (!mode) return;
    if (mode.shape === "point") {
      this.pick([...this.picked, ...corners]);
      if (this.picked.length === mode.most) this.finish();
      return;
    }
    this.tell(corners);
    this.find(mode, withoutRepeats(corners));
  }

  private find(mode: Mode, corners: readonly MapPoint[]): void {
    if (corners.length < mode.least) return;
    const { mission, waiting } = this.context;
    waiting.run(async () => {
      const asked = { layer: this.layer, numbers: this.numbers.of(mode) };
      const found = await orPlanar(mode, corners, mode.find(mission.mission, corners, asked));
      this.sketch?.clear();
      const one = this.keep(mode, corners, found);
      this.context.link.write(KEY, this.linked);
      if (found.profile || found.chart) this.openProfile(one);
    });
  }

  private openProfile({ number, corners, found }: Measurement): void {
    if (found.profile) this.profile.open(`Profile ${number}`, corners, found.profile);
    else if (found.chart)
      this.profile.openChart(`${found.chart.title} ${number}`, corners, found.chart);
  }

  private draw(): void {
    const { view, mission, layers } = this.context;
    const rasters = layers.all.filter(({ type }) => type === "raster");
    if (!rasters.some(({ id }) => id === this.layer)) this.layer = rasters[0]?.id ?? null;
    this.drawn.show(this.all);
    const panel = measurePanel(this.all, this.mode, {
      finish: () => this.finish(),
      layers: rasters.map((one) => [one.id, `${kindTitle(one.kind)}, ${scopeTitle(one.scope)}`]),
      layer: this.layer,
      numbers: this.numbers,
      chooseLayer: (id) => {
        this.layer = id;
      },
      start: (mode) => (mode === this.mode ? this.stop() : this.start(mode)),
      zoomTo: ({ corners, found }) => view.fit(found.overlay?.bounds ?? boundsOf(corners)),
      remove: (one) => {
        this.all = this.all.filter((other) => other !== one);
        this.context.link.write(KEY, this.linked);
        this.draw();
      },
      openProfile: (one) => this.openProfile(one),
      saveCsv: () => saveFile("measurements.csv", "text/csv", measurementsCsv(this.all)),
      saveProfiles: () => saveFile("profiles.csv", "text/csv", profilesCsv(this.all)),
      saveGeojson: () => {
        const text = measurementsGeojson(this.all, mission, view.local);
        saveFile("measurements.geojson", "application/geo+json", text);
      },
    });
    this.panel.replaceChildren(panel);
  }
}
