/** One mission on the screen: what its parts share, and the parts. */

import { firstBounds } from "../map/layers";
import { MapView } from "../map/map-view";
import { keepFormat, keptFormat } from "../page/coordinate-format";
import { localMap } from "../map/projection";
import { CARTOGRAPHERS_SUN } from "../map/shading";
import type { Shell } from "../page/shell";
import { TAB_KEYS, TABS } from "../page/tabs";
import { cursorPart } from "../parts/cursor/part";
import { furniturePart } from "../parts/furniture/part";
import { layersPart } from "../parts/layers/part";
import { pointPart } from "../parts/point/part";
import { searchPart } from "../parts/search/part";
import type { Account } from "../server/account";
import { isVersion } from "../server/versions";
import type { Layer, Mission } from "../server/records";
import type { Context, Part, Events } from "./context";
import { Observable } from "./observable";
import { LayerList } from "./layer-list";
import { LinkHistory } from "./link-history";
import { PlaceActions } from "./place-actions";
import { Shortcuts } from "./shortcuts";
import { Signal } from "./signal";
import { parseLink } from "./state";
import { StopFrames } from "./stop-frames";
import { Store } from "./store";
import { Waiting } from "./waiting";

/** Parts that the map itself needs, in the order of their tabs; `later-parts` follow when it is drawn. */
const PARTS: readonly Part[] = [layersPart, searchPart, furniturePart, cursorPart, pointPart];
/** The rest of the page loads after this time even if the map is not drawn: the server is slow, or the page hidden. */
const LATEST_MS = 4000;

const events = (): Events => ({
  pointer: new Signal(),
  click: new Signal(),
  cursor: new Signal(),
  imageHovered: new Signal(),
  stop: new Signal(),
  identified: new Signal(),
  measure: new Signal(),
  ellipses: new Signal(),
  serverEvent: new Signal(),
  reconnected: new Signal(),
});

export class Session {
  private readonly lifetime = new AbortController();
  private readonly context: Context;

  constructor(page: Shell, mission: Mission, layers: readonly Layer[], lastEvent: string | null) {
    page.clear();
    const state = new Store(location.hash);
    const [place, on, order] = [state.get("at"), state.get("on"), state.get("order")];
    const other = state.get("m");
    state.set("m", mission.mission);
    const drawing = { sols: state.get("sol"), ellipseFactor: 1, solsAt: new Map() };
    const view = new MapView(page.map, mission, layers, localMap(mission), drawing);
    this.context = {
      page,
      mission,
      layers: new LayerList(layers, on, order),
      view,
      drawing,
      sun: new Observable(CARTOGRAPHERS_SUN),
      state,
      history: new LinkHistory(this.lifetime.signal, () => state.link),
      account: new Observable<Account | null>(null),
      waiting: new Waiting(page, () => view.map.render()),
      keys: new Shortcuts(),
      places: new PlaceActions(),
      frames: new StopFrames(mission.mission, this.lifetime.signal),
      coordinates: new Observable(keptFormat()),
      events: events(),
      lastEvent,
      signal: this.lifetime.signal,
    };
    view.setLayers(this.context.layers.every);
    if (place) view.goTo(place);
    else view.fit(firstBounds(layers) ?? mission.bounds, 0);
    this.listen();
    for (const part of PARTS) part(this.context);
    const unknown = other !== null && other !== mission.mission ? [`mission ${other}`] : [];
    void this.addLaterParts(unknown);
  }

  private async addLaterParts(unknown: readonly string[]): Promise<void> {
    const { waiting, signal } = this.context;
    const late = new Promise((resolve) => setTimeout(resolve, LATEST_MS));
    await Promise.race([waiting.painted, late]);
    waiting.run(async () => {
      try {
        const { LATER_PARTS } = await import("./later-parts");
        if (signal.aborted) return;
        for (const part of LATER_PARTS) part(this.context);
        const { page, state } = this.context;
        if (state.get("tab") !== TABS[0] || state.get("pt")) page.showTab(state.get("tab"));
        this.noteUnknown(unknown);
      } finally {
        waiting.whole();
      }
    });
  }

  dispose(): void {
    this.lifetime.abort();
    this.context.waiting.stop();
    this.context.view.dispose();
  }

  private listen(): void {
    const { page, view, waiting, events, keys, layers, state, drawing } = this.context;
    const { frames, coordinates, history } = this.context;
    view.map.on("rendercomplete", () => {
      history.flush();
      waiting.settle();
    });
    view.map.on("loadstart", () => waiting.markLoading());
    layers.replaced.on(() => view.setLayers(layers.every));
    layers.versionsChanged.on(() => view.setLayers(layers.every));
    layers.replaced.on(() => frames.forget());
    coordinates.changed.on(keepFormat);
    state.on("sol", (sols) => {
      drawing.sols = sols;
      view.redraw();
    });
    page.onTab((name) => state.set("tab", name));
    state.on("tab", (name) => page.showTab(name));
    for (const [key, name, title] of TAB_KEYS)
      keys.add(key, `${title} tab`, () => page.enterTab(name));
    const moved = state.follow("at", (place) => place && view.goTo(place));
    view.map.on("moveend", () => moved(view.place));
    page.panes.onArranged(state.follow("panes", (places) => page.panes.arrange(places)));
    this.linkLayers();
    state.changed.on(() => history.changed());
    history.changed();
    events.reconnected.on(() => {
      view.reloadTiles();
      waiting.answered();
    });
    document.addEventListener("keydown", keys.pressed, { signal: this.lifetime.signal });
  }

  /** The list of layers has more than a link: also how hidden layers were shown. */
  private linkLayers(): void {
    const { layers, state } = this.context;
    const show = () => {
      const on = state.get("on");
      if (on) layers.follow(on, state.get("order"));
    };
    const [putOn, putOrder] = [state.follow("on", show), state.follow("order", show)];
    const put = () => {
      putOn(layers.on);
      putOrder(layers.isRearranged);
    };
    layers.changed.on(put);
    layers.rearranged.on(put);
    layers.versionsChanged.on(put);
    put();
  }

  /** Shows the link that is now in the address; false if it is of another mission. */
  follow(): boolean {
    const { mission, state, history, view } = this.context;
    const { m } = parseLink(location.hash).state;
    if (m !== null && m !== mission.mission) return false;
    history.moved();
    state.restore(location.hash);
    const place = state.get("at");
    if (place) view.goTo(place); // the state has the place of the map when it last stopped moving
    state.set("m", mission.mission);
    this.noteUnknown([]);
    return true;
  }

  /** Lists the parts of a link that are not shown. */
  private noteUnknown(others: readonly string[]): void {
    const { layers, state, waiting } = this.context;
    const layersUnknown = layers.missing.filter((id) => !isVersion(id)).map((id) => `layer ${id}`);
    const unknown = [...others, ...state.unknown, ...layersUnknown];
    if (unknown.length > 0)
      waiting.notify(`Not shown, because unknown here: ${unknown.join(", ")}`);
  }
}
