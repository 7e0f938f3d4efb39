/** One mission on the screen: what its parts share, and the parts. */

import { firstBounds } from "../map/layers";
import { MapView } from "../map/map-view";
import { keepFormat, keptFormat } from "../page/coordinate-format";
import { localMap } from "../map/projection";
import { CARTOGRAPHERS_SUN } from "../map/shading";
import { isSame } from "../map/sols";
import type { Shell } from "../page/shell";
import { cursorPart } from "../parts/cursor/part";
import { furniturePart } from "../parts/furniture/part";
import { layersPart } from "../parts/layers/part";
import { pointPart } from "../parts/point/part";
import { searchPart } from "../parts/search/part";
import type { Account } from "../server/account";
import { isVersion } from "../server/versions";
import type { Layer, Mission } from "../server/records";
import type { Context, Part, Signals } from "./context";
import { Kept, LinkBook } from "./kept";
import { LayerBook } from "./layer-book";
import { LinkHistory } from "./link-history";
import { formatPermalink, type Permalink, parsePermalink, unreadable } from "./permalink";
import { PlaceActions } from "./place-actions";
import { Shortcuts } from "./shortcuts";
import { HeldSignal, Signal } from "./signal";
import { StopFrames } from "./stop-frames";
import { Waiting } from "./waiting";

/** Parts that the map itself needs, in the order of their tabs; `later-parts` follow when it is drawn. */
const PARTS: readonly Part[] = [layersPart, searchPart, furniturePart, cursorPart, pointPart];
/** The rest of the page loads after this time even if the map is not drawn: the server is slow, or the page hidden. */
const LATEST_MS = 4000;
/** The tab that a link does not name. */
const FIRST_TAB = "point";

const signals = (): Signals => ({
  pointer: new Signal(),
  click: new Signal(),
  cursor: new Signal(),
  image: new HeldSignal(),
  imageHovered: new Signal(),
  stop: new Signal(),
  imagesOf: new Signal(),
  panorama: new Signal(),
  identify: new Signal(),
  identified: new Signal(),
  measure: new Signal(),
  sols: new Signal(),
  ellipses: new Signal(),
  compare: new HeldSignal(),
  serverEvent: new Signal(),
  reconnected: new Signal(),
  view: new Signal(),
});

export class Session {
  private readonly life = new AbortController();
  private readonly context: Context;
  /** The link as it was opened. */
  private readonly opened = location.hash;

  constructor(
    page: Shell,
    mission: Mission,
    layers: readonly Layer[],
    link: Permalink,
    lastEvent: string | null,
  ) {
    page.clear();
    const drawing = { sols: link.sols, ellipseFactor: 1, solsAt: new Map() };
    const view = new MapView(page.map, mission, layers, localMap(mission), drawing);
    this.context = {
      page,
      mission,
      layers: new LayerBook(layers, link.on, link.ordered),
      view,
      drawing,
      sun: new Kept(CARTOGRAPHERS_SUN),
      link: new LinkBook(link.more),
      history: new LinkHistory(this.life.signal),
      account: new Kept<Account | null>(null),
      waiting: new Waiting(page, () => view.map.render()),
      keys: new Shortcuts(),
      places: new PlaceActions(),
      frames: new StopFrames(mission.mission, this.life.signal),
      coordinates: new Kept(keptFormat()),
      signals: signals(),
      lastEvent,
      alive: this.life.signal,
    };
    view.setLayers(this.context.layers.every);
    if (link.place) view.goTo(link.place);
    else view.fit(firstBounds(layers) ?? mission.bounds, 0);
    this.listen();
    for (const part of PARTS) part(this.context);
    void this.addLaterParts();
  }

  private async addLaterParts(): Promise<void> {
    const { waiting, alive } = this.context;
    const late = new Promise((resolve) => setTimeout(resolve, LATEST_MS));
    await Promise.race([waiting.painted, late]);
    waiting.run(async () => {
      try {
        const { LATER_PARTS } = await import("./later-parts");
        if (alive.aborted) return;
        for (const part of LATER_PARTS) part(this.context);
        this.linkTabs();
        for (const signal of Object.values(this.context.signals))
          if (signal instanceof HeldSignal) signal.release();
        this.noteUnknown(this.opened);
      } finally {
        waiting.whole();
      }
    });
  }

  dispose(): void {
    this.life.abort();
    this.context.waiting.stop();
    this.context.view.dispose();
  }

  private listen(): void {
    const { view, waiting, signals, keys, layers, link, drawing } = this.context;
    const { frames, coordinates } = this.context;
    view.map.on("rendercomplete", () => waiting.settle());
    view.map.on("loadstart", () => waiting.unsettle());
    view.map.on("moveend", () => signals.view.emit());
    layers.changed.on(() => signals.view.emit());
    layers.rearranged.on(() => signals.view.emit());
    link.changed.on(() => signals.view.emit());
    layers.replaced.on(() => view.setLayers(layers.every));
    layers.versionsChanged.on(() => {
      view.setLayers(layers.every);
      signals.view.emit();
    });
    layers.replaced.on(() => frames.forget());
    coordinates.changed.on(keepFormat);
    signals.view.on(() => this.writeLink());
    signals.reconnected.on(() => {
      view.reloadTiles();
      waiting.answered();
    });
    signals.sols.on((sols) => {
      drawing.sols = sols;
      view.redraw();
      signals.view.emit();
    });
    document.addEventListener("keydown", keys.pressed, { signal: this.life.signal });
  }

  private writeLink(): void {
    const { mission, view, layers, link, drawing } = this.context;
    const address = formatPermalink({
      mission: mission.mission,
      place: view.place,
      on: layers.on,
      ordered: layers.isRearranged,
      sols: drawing.sols,
      more: link.all,
    });
    this.context.history.write(address);
  }

  /** Shows the link that is now in the address; false if it is of another mission. */
  follow(): boolean {
    const { mission, view, layers, link, drawing, signals, history } = this.context;
    const linked = parsePermalink(location.hash);
    if (linked.mission !== null && linked.mission !== mission.mission) return false;
    history.moved();
    if (linked.place) view.goTo(linked.place);
    if (linked.on) layers.follow(linked.on, linked.ordered);
    if (!isSame(linked.sols, drawing.sols)) signals.sols.emit(linked.sols);
    link.restore(linked.more);
    this.noteUnknown(location.hash);
    return true;
  }

  private linkTabs(): void {
    const { page, link, waiting } = this.context;
    page.onTab((name) => link.write("tab", name === FIRST_TAB ? null : name));
    link.follow("tab", (name) => {
      if (!page.showTab(name ?? FIRST_TAB)) waiting.say(`There is no tab ${name}.`);
    });
  }

  /** Lists the parts of a link that are not shown. */
  private noteUnknown(fragment: string): void {
    const { layers, link, mission, waiting } = this.context;
    const layersUnknown = layers.awaited.filter((id) => !isVersion(id)).map((id) => `layer ${id}`);
    const other = parsePermalink(fragment).mission;
    const missions = other && other !== mission.mission ? [`mission ${other}`] : [];
    const lost = [...missions, ...unreadable(fragment), ...link.unknown, ...layersUnknown];
    if (lost.length > 0) waiting.say(`Not shown, because unknown here: ${lost.join(", ")}`);
  }
}
