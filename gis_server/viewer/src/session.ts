/** One mission on the screen: its map, panels, and what joins them. */

import type Feature from "ol/Feature";
import type Geometry from "ol/geom/Geometry";
import { ApiError, api, UnreachableError } from "./api";
import { button, h } from "./dom";
import { scopeTitle } from "./format";
import { imageDetail, imageList, stopsOf } from "./image-panel";
import { type LayerPanel, layerPanel } from "./layer-panel";
import { firstBounds, firstState, type LayerState, zIndex } from "./layers";
import { MapView } from "./map-view";
import { measure, measuredText } from "./measure";
import { formatPermalink, type Permalink } from "./permalink";
import { pointPanel } from "./point-panel";
import { localMap } from "./projection";
import { readout } from "./readout";
import type { Bounds, Identified, ImageEntry, Layer, MapPoint, Mission } from "./records";
import { scaleBar } from "./scale";
import type { Shell } from "./shell";
import { type StopRow, stopPanel, stopRows } from "./stop-panel";
import { type DrawingState, ellipseFactor, isUnpaired } from "./styles";

const HOVER_MS = 120;
const SCALE_PX = 160;
/** Width of the ground shown around a stop that was asked for, metres. */
const STOP_VIEW_M = 24;

export class Session {
  private readonly states = new Map<string, LayerState>();
  private readonly drawing: DrawingState;
  private readonly view: MapView;
  private readonly panel: LayerPanel;
  private images: readonly ImageEntry[] = [];
  private stop: string | null = null;
  private chosen: string | null = null;
  private pending = 0;
  private isAway = false;
  private hoverTimer: ReturnType<typeof setTimeout> | undefined;
  private asking: AbortController | null = null;
  private readonly onKey = (event: KeyboardEvent) => this.key(event);

  constructor(
    private readonly page: Shell,
    private readonly mission: Mission,
    private readonly layers: readonly Layer[],
    link: Permalink,
  ) {
    this.drawing = { sol: link.sol, ellipseFactor: 1 };
    for (const layer of layers) {
      const first = firstState(layer, layers);
      const opacity = link.on?.get(layer.id);
      this.states.set(
        layer.id,
        link.on ? { visible: opacity !== undefined, opacity: opacity ?? first.opacity } : first,
      );
    }
    page.map.replaceChildren();
    this.view = new MapView(page.map, mission, layers, localMap(mission), this.drawing);
    this.panel = layerPanel(layers, this.states, {
      setVisible: (layer, visible) => this.change(layer, { visible }),
      setOpacity: (layer, opacity) => this.change(layer, { opacity }),
      zoomTo: (layer) => this.view.fit(layer.bounds),
      showProvenance: (layer) => this.guard(() => this.showProvenance(layer)),
      setEllipseFactor: (factor) => {
        this.drawing.ellipseFactor = factor;
        this.view.redraw();
      },
    });
    page.layers.replaceChildren(this.panel.element);
    this.tools();
    if (link.place) this.view.goTo(link.place);
    else this.view.fit(this.firstBounds(), 0);
    this.listen();
    this.showHint();
    for (const layer of layers) this.apply(layer);
    this.guard(() => this.loadImages());
    this.guard(() => this.loadStops());
  }

  dispose(): void {
    clearTimeout(this.hoverTimer);
    this.asking?.abort();
    document.removeEventListener("keydown", this.onKey);
    this.view.dispose();
  }

  /** What is shown at first, else all there is. */
  private firstBounds(): Bounds {
    return firstBounds(this.layers) ?? this.mission.bounds;
  }

  // Layers

  private state(layer: Layer): LayerState {
    return this.states.get(layer.id) ?? { visible: false, opacity: 1 };
  }

  private change(layer: Layer, part: Partial<LayerState>): void {
    this.states.set(layer.id, { ...this.state(layer), ...part });
    this.apply(layer);
    this.writeLink();
  }

  private apply(layer: Layer): void {
    const shown = this.view.shown.get(layer.id);
    const state = this.state(layer);
    shown?.map.setVisible(state.visible);
    shown?.map.setOpacity(state.opacity);
    if (state.visible && shown) this.guard(async () => void (await shown.load()));
  }

  private async showProvenance(layer: Layer): Promise<void> {
    const document = await api.provenance(layer);
    const text = h("pre", { class: "json" }, JSON.stringify(document, null, 2));
    this.page.dialog(`${layer.title}: how it was made`, text);
  }

  // Waiting and failing

  /** Runs what needs the server; what goes wrong is said on the banner. */
  private guard(work: () => Promise<void>): void {
    this.pending += 1;
    document.documentElement.dataset["ready"] = "false";
    work()
      .catch((reason: unknown) => this.fail(reason))
      .finally(() => {
        this.pending -= 1;
        if (this.pending === 0) this.view.map.render();
      });
  }

  private fail(reason: unknown): void {
    if (reason instanceof DOMException && reason.name === "AbortError") return;
    this.isAway = reason instanceof UnreachableError;
    if (reason instanceof UnreachableError)
      this.page.banner(reason.message, () => location.reload());
    else if (reason instanceof ApiError)
      this.page.banner(reason.message, () => this.page.banner(null));
    else throw reason;
  }

  private settle(): void {
    if (this.pending === 0) document.documentElement.dataset["ready"] = "true";
  }

  // The map

  private listen(): void {
    const { map, view } = this.view;
    map.on("rendercomplete", () => this.settle());
    map.on("loadstart", () => {
      document.documentElement.dataset["ready"] = "false";
    });
    map.on("moveend", () => this.writeLink());
    const tune = () => this.furniture();
    view.on("change:resolution", tune);
    view.on("change:rotation", tune);
    this.furniture();
    this.view.onPointer((event, point) => {
      if (event.dragging) return;
      this.pointAt(point, event.pixel);
    });
    this.view.onClick((event, point) => this.click(event.pixel, point));
    this.page.map.addEventListener("pointerleave", () => {
      clearTimeout(this.hoverTimer);
      this.page.tip.hidden = true;
      this.highlightChosen();
    });
    document.addEventListener("keydown", this.onKey);
  }

  private furniture(): void {
    const bar = scaleBar(this.view.resolution, SCALE_PX);
    this.page.scale.replaceChildren(
      h("span", {}, bar.label),
      h("i", { style: `width:${bar.px.toFixed(2)}px`, "data-metres": bar.metres }),
    );
    const arrow = this.page.north.querySelector<HTMLElement>(".arrow");
    if (arrow) arrow.style.transform = `rotate(${this.view.place.rotationDeg}deg)`;
  }

  private writeLink(): void {
    const on = new Map(
      [...this.states]
        .filter(([, { visible }]) => visible)
        .map(([id, { opacity }]) => [id, opacity] as const),
    );
    const link = {
      mission: this.mission.mission,
      place: this.view.place,
      on,
      sol: this.drawing.sol,
    };
    history.replaceState(null, "", formatPermalink(link));
  }

  private pointAt(point: MapPoint, pixel: number[]): void {
    this.tell(point, null);
    this.hover(pixel);
    clearTimeout(this.hoverTimer);
    this.asking?.abort();
    this.hoverTimer = setTimeout(() => {
      this.asking = new AbortController();
      api
        .identify(this.mission.mission, point, this.asking.signal)
        .then((found) => {
          if (this.isAway) this.page.banner(null);
          this.isAway = false;
          this.tell(point, found);
        })
        .catch((reason: unknown) => this.fail(reason));
    }, HOVER_MS);
  }

  private tell(point: MapPoint, found: Identified | null): void {
    const heightOf = (id: string) => {
      const layer = this.view.shown.get(id)?.layer;
      return layer && this.state(layer).visible ? zIndex(layer) : null;
    };
    this.page.readout.replaceChildren(
      ...readout(point, this.view.resolution, this.view.local, found, heightOf),
    );
  }

  private hover(pixel: number[]): void {
    const touched = this.view.isMeasuring ? null : this.view.touched(pixel);
    this.page.map.style.cursor = touched ? "pointer" : "";
    this.page.tip.hidden = !touched;
    if (!touched) {
      this.highlightChosen();
      return;
    }
    this.view.setHighlight([touched.feature]);
    this.page.tip.replaceChildren(...tipOf(touched.feature, touched.layer));
    this.placeTip(pixel);
  }

  /** Beside the pointer, on the side where there is room. */
  private placeTip([x = 0, y = 0]: number[]): void {
    const { tip, map } = this.page;
    const left = x + 14 + tip.offsetWidth > map.clientWidth ? x - 10 - tip.offsetWidth : x + 14;
    const top = y + 14 + tip.offsetHeight > map.clientHeight ? y - 10 - tip.offsetHeight : y + 14;
    tip.style.transform = `translate(${Math.max(4, left)}px, ${Math.max(4, top)}px)`;
  }

  private click(pixel: number[], point: MapPoint): void {
    this.page.tip.hidden = true;
    const image = this.view.touched(pixel)?.feature.get("image");
    if (typeof image === "string") this.openImage(image);
    else this.identify(point);
  }

  identify(point: MapPoint): void {
    this.view.setMark(point);
    this.guard(async () => {
      const found = await api.identify(this.mission.mission, point);
      const open = (id: string) => this.openImage(id);
      const hover = (id: string | null) => this.hoverImage(id);
      this.page.panels.point.replaceChildren(pointPanel(found, open, hover));
      this.page.showTab("point");
    });
  }

  private showHint(): void {
    this.page.panels.point.replaceChildren(
      h(
        "p",
        { class: "hint" },
        "Click on the map: what every layer says there, and the images that see it. Click a pointing line or footprint to open its image.",
      ),
      h("p", { class: "hint" }, this.mission.lsl_note ?? ""),
      h(
        "p",
        { class: "hint" },
        `Origin: ${this.mission.landing.name}, ${this.mission.landing.source}`,
      ),
    );
  }

  // Images

  private async loadImages(): Promise<void> {
    this.images = await api.images(this.mission.mission, {});
    this.drawImages();
  }

  /** Sols that images or products are of. */
  private solsKnown(): number[] {
    const known = [
      ...this.images.map(({ sol }) => sol),
      ...this.layers.flatMap(({ sols }) => [...sols]),
    ];
    return [...new Set(known)].sort((a, b) => a - b);
  }

  private filters(): HTMLElement {
    const days = this.solsKnown();
    const place = this.drawing.sol === null ? 0 : days.indexOf(this.drawing.sol) + 1;
    const name = h("output", {}, place > 0 ? `sol ${days[place - 1]}` : "all sols");
    const slider = h("input", {
      type: "range",
      min: 0,
      max: days.length,
      step: 1,
      value: place,
      "aria-label": "sol",
      class: "sol",
      oninput: () => {
        this.drawing.sol = days[Number(slider.value) - 1] ?? null;
        name.textContent = this.drawing.sol === null ? "all sols" : `sol ${this.drawing.sol}`;
        this.view.redraw();
        this.drawList();
        this.writeLink();
      },
    });
    const stops = h(
      "select",
      {
        "aria-label": "stop",
        onchange: () => {
          this.stop = stops.value || null;
          this.drawList();
        },
      },
      h("option", { value: "" }, "all stops"),
      ...stopsOf(this.images).map(([id, title]) =>
        h("option", { value: id, selected: id === this.stop }, title),
      ),
    );
    return h("div", { class: "filters" }, h("label", { class: "inline" }, name, slider), stops);
  }

  private readonly detail = h("div");
  private readonly list = h("div");

  private drawImages(): void {
    this.page.panels.images.replaceChildren(this.detail, this.filters(), this.list);
    this.drawList();
  }

  private drawList(): void {
    const { sol } = this.drawing;
    const some = this.images.filter(
      (image) => (sol === null || image.sol === sol) && (!this.stop || image.stop === this.stop),
    );
    this.list.replaceChildren(
      imageList(some, this.chosen, {
        open: (id) => this.openImage(id),
        hover: (id) => this.hoverImage(id),
      }),
    );
  }

  openImage(id: string): void {
    const image = this.images.find((entry) => entry.id === id);
    if (!image) {
      this.page.banner(`the server lists no image ${id}`, () => this.page.banner(null));
      return;
    }
    this.chosen = id;
    this.detail.replaceChildren(
      imageDetail(
        image,
        (other) => this.openImage(other),
        ({ browse }) =>
          this.page.dialog(id, h("img", { class: "large", src: browse, alt: `image ${id}` })),
      ),
    );
    this.drawList();
    this.page.showTab("images");
    this.page.panels.images.scrollTop = 0;
    this.highlightChosen();
  }

  private hoverImage(id: string | null): void {
    if (id === null) this.highlightChosen();
    else this.guard(async () => this.view.setHighlight(await this.viewing(id)));
  }

  private highlightChosen(): void {
    if (this.chosen === null) this.view.setHighlight([]);
    else this.hoverImage(this.chosen);
  }

  /** Footprint and pointing line of an image, loaded if they are not yet. */
  private async viewing(id: string): Promise<Feature<Geometry>[]> {
    const kinds = [...this.view.shown.values()].filter(
      ({ layer }) => layer.kind === "footprints" || layer.kind === "pointing",
    );
    const sources = await Promise.all(kinds.map((shown) => shown.load()));
    const all = sources.flatMap((source) => source?.getFeatures() ?? []);
    const seen = new Set<string>();
    return all.filter((feature) => {
      if (feature.get("image") !== id) return false;
      const type = feature.getGeometry()?.getType() ?? "";
      return !seen.has(type) && seen.add(type);
    });
  }

  // Stops

  private async loadStops(): Promise<void> {
    const widest = this.layers.filter((layer) => layer.kind === "stops");
    const level = ["region", "sol", "stop"].find((name) =>
      widest.some((layer) => layer.level === name),
    );
    const chosen = widest.filter((layer) => layer.level === level);
    const sources = await Promise.all(chosen.map((layer) => this.view.shown.get(layer.id)?.load()));
    const features = sources.flatMap((source) => source?.getFeatures() ?? []);
    this.page.panels.stops.replaceChildren(
      stopPanel(stopRows(features), (at) => this.zoomToStop(at)),
    );
    this.sizeEllipses(features, stopRows(features));
  }

  private sizeEllipses(features: readonly Feature<Geometry>[], rows: readonly StopRow[]): void {
    const majors = features.map((feature) => Number(feature.get("ellipse_semi_major_m") ?? 0));
    const norths = rows.map(({ at }) => at[1]);
    const easts = rows.map(({ at }) => at[0]);
    const extent = Math.hypot(
      Math.max(...norths) - Math.min(...norths),
      Math.max(...easts) - Math.min(...easts),
    );
    this.drawing.ellipseFactor = ellipseFactor(
      Math.max(0, ...majors),
      Math.max(extent, STOP_VIEW_M),
    );
    this.panel.setEllipseFactor(this.drawing.ellipseFactor);
    this.view.redraw();
  }

  private zoomToStop([east, north]: MapPoint): void {
    const half = STOP_VIEW_M / 2;
    this.view.fit([east - half, north - half, east + half, north + half]);
  }

  // Tools

  private tools(): void {
    const ruler = button("measure a distance (m)", "ruler", () => this.toggleRuler(), {
      class: "measure",
      "aria-pressed": "false",
    });
    this.page.toolbar.replaceChildren(
      button("zoom in (+)", "plus", () => this.view.zoomBy(0.5)),
      button("zoom out (-)", "minus", () => this.view.zoomBy(2)),
      button("show everything (f)", "fit", () => this.view.fit(this.firstBounds()), {
        class: "fit",
      }),
      ruler,
      button(
        "copy the link to this view",
        "link",
        () => void navigator.clipboard?.writeText(location.href),
      ),
    );
    this.page.north.replaceChildren(
      h(
        "button",
        {
          type: "button",
          title: "north up (n); turn with Alt+Shift+drag",
          "aria-label": "north up",
          onclick: () => this.view.northUp(),
        },
        h("span", { class: "arrow" }, h("b", {}, "N"), h("i", {})),
      ),
    );
  }

  private toggleRuler(on = !this.view.isMeasuring): void {
    this.page.toolbar.querySelector(".measure")?.setAttribute("aria-pressed", String(on));
    this.page.ruler.hidden = !on;
    if (!on) {
      this.view.stopMeasuring();
      return;
    }
    const tell = (line: readonly MapPoint[]) => {
      this.page.ruler.textContent = measuredText(measure(line));
    };
    tell([]);
    this.view.startMeasuring(tell);
  }

  private key(event: KeyboardEvent): void {
    const target = event.target as HTMLElement;
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    if (event.key === "Escape") this.toggleRuler(false);
    if (["INPUT", "SELECT", "TEXTAREA"].includes(target.tagName)) return;
    if (event.key === "m") this.toggleRuler();
    if (event.key === "n") this.view.northUp();
    if (event.key === "f") this.view.fit(this.firstBounds());
  }
}

function tipOf(feature: Feature<Geometry>, layer: Layer): Node[] {
  const image = feature.get("image");
  if (typeof image === "string") {
    const reason = feature.get("unpaired_because");
    const alone = isUnpaired(feature) ? `without partner: ${reason ?? "no reason recorded"}` : "";
    const facts = `sol ${feature.get("sol") ?? "?"} · ${feature.get("instrument") ?? ""} ${feature.get("eye") ?? ""}`;
    return [h("b", {}, image), h("span", {}, facts), ...(alone ? [h("em", {}, alone)] : [])];
  }
  const stop = String(feature.get("stop") ?? layer.title);
  return [h("b", {}, scopeTitle(stop)), h("span", {}, String(feature.get("solution") ?? ""))];
}
