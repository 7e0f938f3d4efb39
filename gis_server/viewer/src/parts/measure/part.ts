/** Measuring on the map: a kind is chosen, a shape is drawn, and the server measures it on the ground. */

import "./measure.css";
import { kindTitle } from "../../map/layers";
import { isForMap, Sketch } from "../../map/sketch";
import { button, facts } from "../../page/dom";
import { scopeTitle } from "../../page/format";
import { saveFile } from "../../page/save";
import type { MapPoint } from "../../server/records";
import type { Context } from "../../session/context";
import { addPane } from "../../session/pane";
import { type Measured, textOf } from "../../session/state";
import { orPlanar, withoutRepeats } from "./corners";
import { boundsOf, DrawnMeasurements } from "./drawn";
import { type Measurement, measurementsCsv, measurementsGeojson, profilesCsv } from "./export";
import { GroundProfile } from "./ground-profile";
import { chosenNumber, type Found, type Mode } from "./mode";
import { MODES } from "./modes";
import { ChosenNumbers } from "./numbers";
import { measurePanel } from "./panel";
import { quantityText } from "./quantities";

/** The text about a line that was drawn elsewhere. */
const BETWEEN = ["straight, in space", "length on the map", "rise", "slope"];

export function measurePart(context: Context): void {
  const { page, keys, places, events, signal } = context;
  const panel = page.addTab("measure");
  const tool = button("measure (m)", "ruler", () => measuring.toggle(), {
    class: "measure",
    "aria-pressed": "false",
  });
  const measuring = new Measuring(context, panel, tool);
  page.addTool(tool, "measure");
  const [distance, viewshed] = ["distance", "viewshed"].map((key) =>
    MODES.find((mode) => mode.key === key),
  );
  if (distance)
    places.add({
      title: "Measure from here",
      run: (point) => measuring.start(distance, point),
    });
  if (distance) events.measure.on(({ corners, box }) => measuring.between(distance, corners, box));
  if (viewshed)
    places.add({ title: "Viewshed from here", run: (point) => measuring.at(viewshed, point) });
  keys.add("m", "measure a distance", () => measuring.toggle());
  keys.add("Escape", "stop measuring", () => measuring.stop());
  document.addEventListener("keydown", (event) => drawingKey(event, measuring), { signal });
  signal.addEventListener("abort", () => measuring.dispose());
}

/** Enter and Backspace for places that are picked one by one; what is drawn has its own. */
function drawingKey(event: KeyboardEvent, measuring: Measuring): void {
  if (!isForMap(event)) return;
  if (event.key === "Enter") measuring.finish();
  if (event.key === "Backspace") measuring.undo();
}

/** Equal for the same measurement in a link, which is rounded to the millimetre. */
const keyOf = (one: Measured) => textOf("measure", [one]) ?? "";

class Measuring {
  private readonly drawn: DrawnMeasurements;
  /** Results by `keyOf`. */
  private readonly known = new Map<string, Found>();
  private measuring: Promise<void> = Promise.resolve();
  private mode: Mode | null = null;
  private sketch: Sketch | null = null;
  private picked: readonly MapPoint[] = [];
  private layer: string | null = null;
  private readonly numbers = new ChosenNumbers();

  constructor(
    private readonly context: Context,
    private readonly panel: HTMLElement,
    private readonly tool: HTMLElement,
  ) {
    this.drawn = new DrawnMeasurements(context.view.map);
    addPane(context, "profile", {
      title: "Profile",
      side: "below",
      load: async (write) => new GroundProfile(context, (number) => this.numbered(number), write),
    });
    context.state.follow("measure", (list) => this.show(list));
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
    this.measure(mode, [point]);
  }

  /** Measures a line that was drawn elsewhere, and shows the result in a box. */
  between(mode: Mode, corners: readonly MapPoint[], box: HTMLElement): void {
    this.context.waiting.run(async () => {
      const { found } = await this.keep(mode, corners);
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
    this.update([]);
    const end = (corners: readonly MapPoint[]) => this.ended(corners);
    const change = (corners: readonly MapPoint[]) => this.update(corners);
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
    this.measure(this.mode, points);
  }

  dispose(): void {
    this.sketch?.stop();
    this.drawn.dispose();
  }

  /** Measures what is in the state and was not measured yet. */
  private show(list: readonly Measured[]): void {
    this.draw();
    const unknown = () => list.filter((one) => !this.known.has(keyOf(one)));
    if (unknown().length === 0) return;
    this.context.waiting.run(() => {
      this.measuring = this.findAll(unknown());
      return this.measuring;
    });
  }

  private async findAll(list: readonly Measured[]): Promise<void> {
    for (const one of list) {
      const mode = MODES.find(({ key }) => key === one.mode);
      if (mode && one.corners.length >= mode.least) await this.find(mode, one);
    }
    this.draw();
  }

  private async find(mode: Mode, one: Measured): Promise<Found> {
    const { corners, layer } = one;
    const { mission } = this.context.mission;
    const numbers = Object.fromEntries(
      (mode.numberFields ?? []).map((inputs, k) => [
        inputs.key,
        chosenNumber(inputs, one.numbers[k]),
      ]),
    );
    const inputs = { layer: layer ?? this.layer, numbers };
    const found = await orPlanar(mode, corners, mode.find(mission, corners, inputs));
    this.known.set(keyOf(one), found);
    return found;
  }

  private get all(): readonly Measurement[] {
    return this.context.state.get("measure").flatMap((one, k) => {
      const mode = MODES.find(({ key }) => key === one.mode);
      const found = this.known.get(keyOf(one));
      return mode && found ? [{ number: k + 1, mode, corners: one.corners, found }] : [];
    });
  }

  /** The measurement of a number, when all are measured. */
  async numbered(number: number): Promise<Measurement | null> {
    await this.measuring;
    return this.all.find((one) => one.number === number) ?? null;
  }

  private async keep(mode: Mode, corners: readonly MapPoint[]): Promise<Measurement> {
    const numbers = Object.values(this.numbers.of(mode));
    const one = { mode: mode.key, corners, numbers, layer: mode.needsLayer ? this.layer : null };
    const found = await this.find(mode, one);
    const { state } = this.context;
    const list = [...state.get("measure"), one];
    state.set("measure", list);
    return { number: list.length, mode, corners, found };
  }

  /** Removes a measurement; those after it get other numbers. */
  private remove({ number }: Measurement): void {
    const { state } = this.context;
    const profile = state.get("profile");
    state.set("measure", state.get("measure").toSpliced(number - 1, 1));
    if (!profile || profile.of < number) return;
    state.set("profile", profile.of === number ? null : { ...profile, of: profile.of - 1 });
  }

  private update(corners: readonly MapPoint[]): void {
    this.context.page.ruler.textContent = this.mode?.live(corners) ?? "";
  }

  private pick(points: readonly MapPoint[]): void {
    this.picked = points;
    this.update(points);
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
    this.update(corners);
    this.measure(mode, withoutRepeats(corners));
  }

  private measure(mode: Mode, corners: readonly MapPoint[]): void {
    if (corners.length < mode.least) return;
    this.context.waiting.run(async () => {
      const one = await this.keep(mode, corners);
      this.sketch?.clear();
      if (one.found.profile || one.found.chart) this.openProfile(one);
    });
  }

  private openProfile({ number }: Measurement): void {
    this.context.state.set("profile", { of: number, shown: "elevation" });
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
      remove: (one) => this.remove(one),
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
