/** One mission on the screen: what its parts share, and the parts. */

import { firstBounds } from "../map/layers";
import { MapView } from "../map/map-view";
import { localMap } from "../map/projection";
import { CARTOGRAPHERS_SUN } from "../map/shading";
import type { Shell } from "../page/shell";
import { accountPart } from "../parts/account/part";
import { annotationsPart } from "../parts/annotations/part";
import { cursorPart } from "../parts/cursor/part";
import { downloadsPart } from "../parts/downloads/part";
import { editorPart } from "../parts/editor/part";
import { furniturePart } from "../parts/furniture/part";
import { helpPart } from "../parts/help/part";
import { imageViewPart } from "../parts/image-view/part";
import { imagesPart } from "../parts/images/part";
import { layersPart } from "../parts/layers/part";
import { livePart } from "../parts/live/part";
import { measurePart } from "../parts/measure/part";
import { networkPart } from "../parts/network/part";
import { pointPart } from "../parts/point/part";
import { runsPart } from "../parts/runs/part";
import { scenePart } from "../parts/scene/part";
import { stereoPart } from "../parts/stereo/part";
import { searchPart } from "../parts/search/part";
import { sunPart } from "../parts/sun/part";
import { swipePart } from "../parts/swipe/part";
import { traversePart } from "../parts/traverse/part";
import type { Account } from "../server/account";
import type { Layer, Mission } from "../server/records";
import type { Context, Part, Signals } from "./context";
import { Kept, LinkBook } from "./kept";
import { LayerBook } from "./layer-book";
import { formatPermalink, type Permalink } from "./permalink";
import { Shortcuts } from "./shortcuts";
import { Signal } from "./signal";
import { Waiting } from "./waiting";

/** In the order of their tabs and tools on the page. */
const PARTS: readonly Part[] = [
  layersPart,
  searchPart,
  furniturePart,
  cursorPart,
  pointPart,
  imagesPart,
  imageViewPart,
  traversePart,
  measurePart,
  networkPart,
  swipePart,
  sunPart,
  downloadsPart,
  scenePart,
  stereoPart,
  editorPart,
  annotationsPart,
  runsPart,
  helpPart,
  accountPart,
  livePart,
];

const signals = (): Signals => ({
  pointer: new Signal(),
  click: new Signal(),
  cursor: new Signal(),
  image: new Signal(),
  imageHovered: new Signal(),
  identify: new Signal(),
  sol: new Signal(),
  ellipses: new Signal(),
  compare: new Signal(),
  happened: new Signal(),
  view: new Signal(),
});

export class Session {
  private readonly life = new AbortController();
  private readonly context: Context;

  constructor(page: Shell, mission: Mission, layers: readonly Layer[], link: Permalink) {
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
      signals: signals(),
      alive: this.life.signal,
    };
    if (link.place) view.goTo(link.place);
    else view.fit(firstBounds(layers) ?? mission.bounds, 0);
    this.listen();
    for (const part of PARTS) part(this.context);
  }

  dispose(): void {
    this.life.abort();
    this.context.view.dispose();
  }

  private listen(): void {
    const { view, waiting, signals, keys, layers, link, drawing } = this.context;
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
