/** One mission on the screen: what its parts share, and the parts. */

import { firstBounds } from "../map/layers";
import { MapView } from "../map/map-view";
import { keepFormat, keptFormat } from "../page/coordinate-format";
import { localMap } from "../map/projection";
import { CARTOGRAPHERS_SUN } from "../map/shading";
import type { Shell } from "../page/shell";
import { cursorPart } from "../parts/cursor/part";
import { furniturePart } from "../parts/furniture/part";
import { layersPart } from "../parts/layers/part";
import { pointPart } from "../parts/point/part";
import { searchPart } from "../parts/search/part";
import type { Account } from "../server/account";
import type { Layer, Mission } from "../server/records";
import type { Context, Part, Signals } from "./context";
import { Kept, LinkBook } from "./kept";
import { LayerBook } from "./layer-book";
import { formatPermalink, type Permalink } from "./permalink";
import { PlaceActions } from "./place-actions";
import { Shortcuts } from "./shortcuts";
import { HeldSignal, Signal } from "./signal";
import { StopFrames } from "./stop-frames";
import { Waiting } from "./waiting";

/** What the map itself needs, in the order of tabs and tools on the page; `later-parts` follow when it is drawn. */
const PARTS: readonly Part[] = [layersPart, searchPart, furniturePart, cursorPart, pointPart];
/** The rest of the page comes after so long even where the map is not drawn: the server is slow, or the page hidden. */
const LATEST_MS = 4000;

const signals = (): Signals => ({
  pointer: new Signal(),
  click: new Signal(),
  cursor: new Signal(),
  image: new HeldSignal(),
  imageHovered: new Signal(),
  identify: new Signal(),
  sol: new Signal(),
  ellipses: new Signal(),
  compare: new HeldSignal(),
  happened: new Signal(),
  view: new Signal(),
});

export class Session {
  private readonly life = new AbortController();
  private readonly context: Context;

  constructor(
    page: Shell,
    mission: Mission,
    layers: readonly Layer[],
    link: Permalink,
    lastEvent: string | null,
  ) {
    page.clear();
    const drawing = { sol: link.sol, ellipseFactor: 1 };
    const view = new MapView(page.map, mission, layers, localMap(mission), drawing);
    this.context = {
      page,
      mission,
      layers: new LayerBook(layers, link.on, link.ordered),
      view,
      drawing,
      sun: new Kept(CARTOGRAPHERS_SUN),
      link: new LinkBook(link.more),
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
        for (const signal of Object.values(this.context.signals))
          if (signal instanceof HeldSignal) signal.release();
      } finally {
        waiting.whole();
      }
    });
  }

  dispose(): void {
    this.life.abort();
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
    signals.sol.on((sol) => {
      drawing.sol = sol;
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
      sol: drawing.sol,
      more: link.all,
    });
    history.replaceState(null, "", address);
  }
}
