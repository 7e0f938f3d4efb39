/**
 * Tables of features on the map: one at a time, with its filters; selections of row and map are linked.
 */

import GeoJSON from "ol/format/GeoJSON";
import type Geometry from "ol/geom/Geometry";
import Feature from "ol/Feature";
import OlVectorLayer from "ol/layer/Vector";
import VectorSource from "ol/source/Vector";
import "./table.css";
import { ImageFeatures } from "../../map/image-features";
import { marsGeojson } from "../../map/mars-geojson";
import { drawHighlight } from "../../map/styles";
import { h } from "../../page/dom";
import { saveFile } from "../../page/save";
import { api } from "../../server/api";
import { type Context, identify, openImage, type Pointed } from "../../session/context";
import { ALL_ROWS, type Query, type Table, TABLES } from "../../session/state";
import { Grid } from "./grid";
import { choicesOf, type Column, listed, type Row, tableCsv, tableFeatures } from "./rows";
import { type Subject, SUBJECTS } from "./subjects";

const Z_INDEX = 999;
const TOUCH_PX = 6;
/** Ground shown around the feature of a row, metres. */
const AROUND_M = 6;
/** Resolution above which the map zooms to the ground around a row. */
const COARSEST_M = 0.25;
/** Most names in one request. */
const NAMES_AT_ONCE = 100;

export class TableView {
  readonly element: HTMLElement;
  private readonly grid: Grid;
  private readonly source = new VectorSource<Feature<Geometry>>();
  private readonly overlay = new OlVectorLayer({
    source: this.source,
    style: drawHighlight,
    zIndex: Z_INDEX,
  });
  private readonly footprints: ImageFeatures;
  private readonly forget: readonly (() => void)[];
  private readonly count = h("output", { role: "status" });
  private readonly filters = h("span", { class: "inline" });
  private readonly columns = h("button", {
    type: "button",
    class: "text",
    onclick: () => this.change({ hasAllColumns: !this.query.hasAllColumns }),
  });
  private readonly find = h("input", {
    type: "search",
    placeholder: "filter rows",
    "aria-label": "filter rows",
    oninput: () => this.change({ words: this.find.value }),
  });
  private readonly subjects = h(
    "select",
    { "aria-label": "table", onchange: () => this.turnTo() },
    ...SUBJECTS.map(({ key, title }) => h("option", { value: key }, title)),
  );
  private subject = SUBJECTS[0] as Subject;
  private query: Query = ALL_ROWS;
  private rows: readonly Row[] = [];
  private shown: readonly Row[] = [];
  private loading = 0;

  constructor(
    private readonly context: Context,
    private readonly write: (table: Table) => void,
  ) {
    const { view, events, layers, mission, state } = context;
    this.grid = new Grid(
      {
        sort: (column) => this.sort(column),
        choose: (row) => this.choose(row),
        open: (row) => this.open(row),
      },
      (count) => this.offerColumns(count),
    );
    const save = (name: string, run: () => void) =>
      h(
        "button",
        { type: "button", class: "text", title: `save the listed rows`, onclick: run },
        name,
      );
    this.element = h(
      "div",
      { class: "table-view" },
      h(
        "div",
        { class: "table-bar" },
        this.subjects,
        this.find,
        this.filters,
        this.count,
        this.columns,
        save("CSV", () => this.saveCsv()),
        save("GeoJSON", () => this.saveGeojson()),
      ),
      this.grid.element,
    );
    view.map.addLayer(this.overlay);
    this.footprints = new ImageFeatures(() => layers.widest("footprints"));
    this.forget = [
      events.click.on((pointed) => this.clicked(pointed)),
      state.on("image", (image) => image && this.mark("image", image.id)),
      layers.replaced.on(() => this.load()),
      events.serverEvent.on(({ kind, document }) => {
        const isOfEdits = kind === "edits.changed" && document.mission === mission.mission;
        if (isOfEdits && this.subject.key === "annotations") this.load();
      }),
    ];
  }

  focus(): void {
    this.subjects.focus();
  }

  dispose(): void {
    for (const end of this.forget) end();
    this.context.view.map.removeLayer(this.overlay);
    this.grid.dispose();
  }

  show({ subject, ...query }: Table): void {
    const requested = SUBJECTS.find(({ key }) => key === subject) ?? this.subject;
    const isOther = requested !== this.subject || this.loading === 0;
    [this.subject, this.query] = [requested, query];
    this.subjects.value = requested.key;
    this.find.value = query.words;
    if (isOther) this.load();
    else this.draw();
  }

  private turnTo(): void {
    const { value } = this.subjects;
    const subject = TABLES.find((key) => key === value);
    if (subject) this.show({ subject, ...ALL_ROWS });
  }

  private load(): void {
    const { subject } = this;
    const turn = ++this.loading;
    const isLate = () => turn !== this.loading;
    [this.rows, this.shown] = [[], []];
    this.source.clear();
    this.draw();
    this.count.textContent = "loading…";
    this.context.waiting.run(async () => {
      const rows = await subject.load(this.context, (count) => {
        if (!isLate()) this.count.textContent = `loading… ${count.toLocaleString("en")}`;
      });
      if (isLate()) return;
      this.rows = rows;
      this.draw();
    });
  }

  private change(part: Partial<Query>): void {
    this.query = { ...this.query, ...part };
    this.drawRows();
  }

  private sort({ key }: Column): void {
    const { sort, isDescending } = this.query;
    if (sort !== key) this.change({ sort: key, isDescending: false });
    else if (isDescending) this.change({ sort: null, isDescending: false });
    else this.change({ isDescending: true });
  }

  private draw(): void {
    const filters = this.subject.columns.flatMap((column) => this.filter(column) ?? []);
    this.filters.replaceChildren(...filters);
    this.drawRows();
  }

  /** Offers the columns that have no room. */
  private offerColumns(count: number): void {
    const all = this.subject.columns.length;
    this.columns.hidden = count === all && !this.query.hasAllColumns;
    this.columns.textContent = this.query.hasAllColumns
      ? "columns that fit"
      : `all columns (${count} of ${all} fit)`;
  }

  /** Filter of a column; null if there is nothing to choose from. */
  private filter(column: Column): HTMLElement | null {
    const { key, title, isChoice } = column;
    const chosen = this.query.choices.get(key) ?? "";
    const values = isChoice ? choicesOf(this.rows, column) : [];
    if (values.length < 2 && !chosen) return null;
    const select = h(
      "select",
      {
        "aria-label": `only ${title}`,
        onchange: () => {
          const choices = new Map(this.query.choices);
          if (select.value) choices.set(key, select.value);
          else choices.delete(key);
          this.change({ choices });
        },
      },
      h("option", { value: "" }, `any ${title}`),
      ...values.map((value) => h("option", { value, selected: value === chosen }, value)),
    );
    return select;
  }

  private drawRows(): void {
    const { subject, query } = this;
    this.shown = listed(this.rows, query);
    const [some, all] = [this.shown.length, this.rows.length].map((n) => n.toLocaleString("en"));
    this.count.textContent = some === all ? `${all} rows` : `${some} of ${all} rows`;
    this.grid.show(subject.title, subject.columns, this.shown, query);
    this.grid.mounted();
    this.write({ subject: subject.key, ...query });
  }

  /** Shows the feature of a row on the map. */
  private choose(row: Row): void {
    const { view, waiting } = this.context;
    waiting.run(async () => {
      const features = await this.featuresOf(row);
      this.source.clear();
      this.source.addFeatures(features);
      const extent = this.source.getExtent();
      if (features.length === 0 || !extent) return;
      const [west = 0, south = 0, east = 0, north = 0] = extent;
      const [w = 0, s = 0, e = 0, n = 0] = view.view.calculateExtent(view.map.getSize());
      const isInView = w <= west && s <= south && east <= e && north <= n;
      if (!isInView || view.resolution > COARSEST_M)
        view.fit([west - AROUND_M, south - AROUND_M, east + AROUND_M, north + AROUND_M]);
    });
  }

  private async featuresOf({ id, geometry }: Row): Promise<Feature<Geometry>[]> {
    if (geometry) return [new Feature(new GeoJSON().readGeometry(geometry) as Geometry)];
    return (await this.footprints.of(id)).map((feature) => feature.clone());
  }

  private open({ id, geometry }: Row): void {
    if (this.subject.key === "images") openImage(this.context, id);
    else if (geometry?.type === "Point") {
      const [east = 0, north = 0] = geometry.coordinates as readonly number[];
      identify(this.context, [east, north]);
    }
  }

  /** The row of what was clicked on the map. */
  private clicked({ touched, point }: Pointed): void {
    const { named } = this.subject;
    const name = named === undefined ? null : touched?.feature.get(named);
    if (typeof name === "string" && named) this.mark(named, name);
    else if (this.subject.key !== "images") {
      const row = this.nearest(point);
      if (row) this.mark(named, row.id);
    }
  }

  private mark(named: string | undefined, id: string): void {
    if (named !== this.subject.named || !this.grid.mark(id)) return;
    const row = this.shown.find((one) => one.id === id);
    if (row)
      this.context.waiting.run(async () => {
        this.source.clear();
        this.source.addFeatures(await this.featuresOf(row));
      });
  }

  /** The listed row whose shape is nearest to a place, within some pixels. */
  private nearest([east, north]: readonly [number, number]): Row | null {
    let best: Row | null = null;
    let least = TOUCH_PX * this.context.view.resolution;
    for (const row of this.shown) {
      const distance = distanceTo(row, east, north);
      if (distance > least) continue;
      [best, least] = [row, distance];
    }
    return best;
  }

  private saveCsv(): void {
    const { subject, shown } = this;
    saveFile(`${subject.key}.csv`, "text/csv", tableCsv(shown, subject.columns));
  }

  private saveGeojson(): void {
    const { mission, view, waiting } = this.context;
    const { subject, shown } = this;
    waiting.run(async () => {
      const rows = subject.key === "images" ? await this.withFootprints(shown) : shown;
      const text = marsGeojson(tableFeatures(rows), mission, view.local);
      saveFile(`${subject.key}.geojson`, "application/geo+json", text);
    });
  }

  private async withFootprints(rows: readonly Row[]): Promise<readonly Row[]> {
    const layers = this.context.layers.widest("footprints").filter(({ type }) => type === "vector");
    const outlines = new Map<string, Row["geometry"]>();
    for (let k = 0; k < rows.length; k += NAMES_AT_ONCE)
      for (const layer of layers) {
        if (layer.type !== "vector") continue;
        const names = rows.slice(k, k + NAMES_AT_ONCE).map(({ id }) => id);
        const { features } = await api.featuresNamed(layer, names);
        for (const one of features as readonly { id: string; geometry: Row["geometry"] }[])
          outlines.set(one.id, one.geometry);
      }
    return rows.map((row) => ({ ...row, geometry: outlines.get(row.id) ?? null }));
  }
}

function distanceTo({ geometry }: Row, east: number, north: number): number {
  if (!geometry) return Number.POSITIVE_INFINITY;
  if (geometry.type === "Point") {
    const [x = 0, y = 0] = geometry.coordinates as readonly number[];
    return Math.hypot(x - east, y - north);
  }
  const shape = new GeoJSON().readGeometry(geometry) as Geometry;
  const [x = 0, y = 0] = shape.getClosestPoint([east, north]);
  return Math.hypot(x - east, y - north);
}
