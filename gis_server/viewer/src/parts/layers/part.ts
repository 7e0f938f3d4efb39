/** The layers on the map, how they are shown, and the lists in which this is chosen. */

import { getIntersection, isEmpty } from "ol/extent";
import { setBlend } from "../../map/blending";
import { type Shown, tileGrid } from "../../map/map-layers";
import { percentiles } from "../../map/imagery-style";
import { shadesOf } from "../../map/image-tiles";
import { tileUrl } from "../../map/value-tiles";
import { PLAIN } from "../../map/raster-style";
import { rangeInView } from "../../map/stretch";
import { h } from "../../page/dom";
import { api, urls } from "../../server/api";
import type { Layer, RasterLayer } from "../../server/records";
import { isVersion, versions } from "../../server/versions";
import type { Context } from "../../session/context";
import { bringVersions } from "../../session/versions";
import type { LayerActions } from "./actions";
import { layerFilter } from "./filter";
import { Flicker } from "./flicker";
import "./layers.css";
import { mapLegend } from "./legend";
import { shownList } from "./shown-list";
import { type SolActions, solFilter, solsByPlace, solsOf } from "./sol-filter";
import { layerTree } from "./tree";

export function layersPart(context: Context): void {
  const { layers, mission, view, page, drawing, sun, events, state, keys, waiting, signal } =
    context;

  const here = new WeakSet<Shown>();
  /** Fetches what a layer has in view, once. */
  const fetchIn = (shown: Shown) => {
    const { layer, map } = shown;
    if (here.has(shown) || layer.type !== "vector" || !map.getVisible() || !view.shows(layer))
      return;
    waiting.run(async () => {
      await shown.load();
      here.add(shown);
      drawLegend();
    });
  };
  const put = (layer: Layer) => {
    const isDrawn = layers.isDrawn(layer, drawing.sols);
    const shown = isDrawn ? view.made(layer.id) : view.shown.get(layer.id);
    if (!shown) return;
    const state = layers.state(layer);
    shown.map.setVisible(isDrawn);
    shown.map.setOpacity(state.opacity);
    setBlend(shown.map, state.blend);
    shown.map.setZIndex(layers.height(layer));
    if (!isDrawn) return;
    shown.restyle(state.style, sun.value);
    fetchIn(shown);
  };
  const putAll = () => {
    for (const layer of layers.every) put(layer);
  };
  const flicker = new Flicker((layer, visible) =>
    view.shown.get(layer.id)?.map.setVisible(visible),
  );
  const onMap = shownList(actionsOf(context, flicker, () => list()));
  const legend = mapLegend(
    actionsOf(context, flicker, () => list()),
    page.map,
  );
  const drawLegend = () => legend.draw(layers.shown);
  const list = () => {
    onMap.draw(layers.shown);
    drawLegend();
  };

  let tree = layerTree([], actionsOf(context, flicker, list));
  const solActions: SolActions = {
    reportOf: (sol) => urls.solReport(mission.mission, sol),
    choose: (range) => state.set("sol", range),
    record: (steps) =>
      waiting.run(async () => {
        const { recordingDialog } = await import("./playback/dialog");
        page.dialog("Save the playback", recordingDialog(context, steps));
      }),
  };
  let sols = solFilter([], solActions);
  const filter = layerFilter(
    (chosen) => filtered(chosen),
    (condition) => tree.find(condition),
    () => api.images(mission.mission, {}, signal),
  );
  keys.add("l", "filter the list of layers", () => {
    page.openLayers();
    filter.focus();
  });
  const filtered = state.follow("filter", (chosen) => filter.show(chosen));

  const draw = () => {
    tree = layerTree(layers.listed, actionsOf(context, flicker, list));
    sols = solFilter(solsOf(layers.all), solActions);
    sols.set(drawing.sols);
    tree.setSols(drawing.sols);
    page.legend.replaceChildren(legend.element);
    page.layers.replaceChildren(sols.element, onMap.element, filter.element, tree.element);
    filter.setLayers(layers.listed);
    tree.find(filter.condition());
    list();
    putAll();
  };

  let shown = "";
  layers.changed.on((layer) => {
    tree.follow(layer);
    onMap.follow(layer);
    put(layer);
    const now = layers.shown.map(({ id }) => id).join();
    if (now !== shown) list();
    else drawLegend();
    shown = now;
    if (flicker.layer === layer.id && !layers.state(layer).visible) flicker.stop();
  });
  layers.rearranged.on(() => {
    list();
    putAll();
  });
  layers.replaced.on(draw);
  layers.versionsChanged.on(() => {
    list();
    putAll();
  });
  if (layers.missing.some(isVersion))
    waiting.run(() => bringVersions(context, layers.missing.filter(isVersion)));
  view.map.on("moveend", () => view.shown.forEach(fetchIn));
  sun.changed.on(() => {
    for (const layer of layers.shown)
      if (layers.state(layer).style?.quantity === "relief") put(layer);
  });
  const learnSols = () => {
    if (drawing.sols !== null && drawing.solsAt.size === 0)
      waiting.run(async () => {
        const stops = [...layers.widest("stops"), ...layers.widest("mission-stops")];
        drawing.solsAt = solsByPlace(await view.featuresOf(stops));
        view.redraw();
      });
  };
  learnSols();
  layers.replaced.on(() => {
    drawing.solsAt = new Map();
    learnSols();
  });
  state.on("sol", (range) => {
    learnSols();
    sols.set(range);
    tree.setSols(range);
    putAll();
  });
  events.ellipses.on(() => {
    layers.of("stops").forEach((layer) => tree.follow(layer));
    drawLegend();
  });
  signal.addEventListener("abort", () => flicker.stop());
  draw();
}

function actionsOf(context: Context, flicker: Flicker, list: () => void): LayerActions {
  const { page, layers, view, drawing, waiting, state } = context;
  const toggleFlicker = (layer: Layer) => {
    flicker.toggle(layer);
    list();
    for (const one of layers.shown)
      view.shown.get(one.id)?.map.setVisible(layers.isDrawn(one, drawing.sols));
  };
  const add = (version: Layer) => {
    layers.addVersion(version);
    layers.change(version, { visible: true });
  };
  return {
    stateOf: (layer) => layers.state(layer),
    setVisible: (layer, visible) => layers.change(layer, { visible }),
    setOpacity: (layer, opacity) => layers.change(layer, { opacity }),
    setBlend: (layer, blend) => layers.change(layer, { blend }),
    setStyle: (layer, style) => layers.change(layer, { style }),
    stretch: (layer) => waiting.run(() => stretch(context, layer)),
    stretchImagery: (layer, share) => waiting.run(() => stretchImagery(context, layer, share)),
    zoomTo: (layer) => view.fit(layer.bounds),
    showProvenance: (layer) => waiting.run(() => showProvenance(context, layer)),
    elevationsOf: (layer) =>
      view.valuesOf(layer, "elevation_m").filter((value) => typeof value === "number"),
    ellipseFactor: () => drawing.ellipseFactor,
    setEllipseFactor: (factor) => {
      drawing.ellipseFactor = factor;
      view.redraw();
    },
    move: (layer, step) => layers.move(layer, step),
    place: (layer, beside, step) => layers.place(layer, beside, step),
    solo: () => layers.solo,
    flickering: () => flicker.layer,
    toggleSolo: (layer) => layers.setSolo(layers.solo === layer.id ? null : layer),
    toggleFlicker,
    versions: (layer, from) => versions.list(layer, from),
    isThere: ({ id }) => layers.every.some((one) => one.id === id),
    add,
    dismiss: (version) => layers.dismiss(version),
    compare: (version, latest, how) => {
      add(version);
      if (how !== "flicker") {
        page.showTab("compare");
        state.set("compare", { mode: how, a: latest.id, b: version.id, at: 0.5, most: null });
        return;
      }
      layers.change(latest, { visible: true });
      layers.place(version, latest, 1);
      if (flicker.layer !== version.id) toggleFlicker(version);
    },
  };
}

async function stretch(context: Context, layer: RasterLayer): Promise<void> {
  const { view, mission, layers, sun, waiting } = context;
  const style = layers.state(layer).style ?? PLAIN;
  const range = await rangeInView(view.map, mission.tile_matrix_set, layer, style, sun.value);
  if (!range) waiting.notify("no value of this layer is on the screen");
  else layers.change(layer, { style: { ...style, low: range[0], high: range[1] } });
}

/** Most tiles that are read to stretch an image: more would take too long. */
const MOST_TILES = 24;

async function stretchImagery(context: Context, layer: RasterLayer, share: number): Promise<void> {
  const { view, mission, layers, waiting } = context;
  const grid = tileGrid(mission.tile_matrix_set, layer);
  const seen = getIntersection(view.map.getView().calculateExtent(view.map.getSize()), [
    ...layer.bounds,
  ]);
  const addresses: string[] = [];
  if (!isEmpty(seen))
    grid.forEachTileCoord(seen, grid.getZForResolution(view.resolution), ([z = 0, x = 0, y = 0]) =>
      addresses.push(tileUrl(layer.tiles, z, x, y)),
    );
  const found = percentiles(await shadesOf(addresses.slice(0, MOST_TILES)), share);
  if (!found) waiting.notify("no part of this image is on the screen");
  else {
    const style = layers.state(layer).style ?? PLAIN;
    layers.change(layer, { style: { ...style, low: found[0], high: found[1] } });
  }
}

async function showProvenance({ page }: Context, layer: Layer): Promise<void> {
  const document = await api.provenance(layer);
  const text = h("pre", { class: "json" }, JSON.stringify(document, null, 2));
  page.dialog(`${layer.title}: how it was made`, text);
}
