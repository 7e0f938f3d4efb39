/** The layers of dropped files: on the map, in their list, and published as annotations. */

import type BaseLayer from "ol/layer/Base";
import { mayAct } from "../../server/account";
import { edits } from "../../server/edits";
import type { Bounds, MapPoint } from "../../server/records";
import type { Context } from "../../session/context";
import { annotationsOf } from "./annotations";
import { attributes } from "./attributes";

import { RefusedFile } from "./crs";
import { boundsOf } from "./features";
import { drawnFeatures, drawnImage } from "./drawing";
import { fileRow, type RowActions } from "./row";
import { type FileLayer, readFile } from "./read";

/** Colours of files in turn, different from the map's own symbols. */
const COLOURS = ["#0057d9", "#b8005c", "#007a3d", "#8a4b00", "#6a00b8"];
/** Distance at which a line or point is still hit. */
const HIT_PX = 5;
/** Annotations that are written at once. */
const MOST_PUBLISHED = 500;

export class LocalFiles {
  private count = 0;
  /** Names of layers of features, by what draws them. */
  private readonly names = new Map<BaseLayer, string>();

  constructor(
    private readonly context: Context,
    private readonly list: HTMLElement,
  ) {
    context.account.changed.on(() => this.follow());
    context.events.identified.on(({ point, box }) => this.showAttributes(point, box));
  }

  async add(files: readonly File[]): Promise<void> {
    const { mission, view, waiting } = this.context;
    const refused: string[] = [];
    for (const file of files)
      try {
        for (const layer of await readFile(file, { mission, local: view.local })) this.show(layer);
      } catch (reason) {
        if (!(reason instanceof RefusedFile)) throw reason;
        refused.push(reason.message);
      }
    if (refused.length > 0) waiting.notify(refused.join(" "));
  }

  private get mayPublish(): boolean {
    return mayAct(this.context.account.value, "analyst");
  }

  /** Signed-in people may publish. */
  private follow(): void {
    for (const button of this.list.querySelectorAll<HTMLButtonElement>(".publish"))
      button.hidden = !this.mayPublish;
  }

  private show(layer: FileLayer): void {
    const { view } = this.context;
    const { map } = view;
    const colour = COLOURS[this.count++ % COLOURS.length] ?? "#0057d9";
    const drawn =
      layer.type === "features"
        ? drawnFeatures(layer, colour)
        : drawnImage(layer, view.local.projection);
    const bounds = layer.type === "features" ? boundsOf(layer.features) : imageBounds(layer);
    map.addLayer(drawn.map);
    if (layer.type === "features") this.names.set(drawn.map, layer.name);
    const actions: RowActions = {
      setVisible: (visible) => drawn.map.setVisible(visible),
      setOpacity: (opacity) => drawn.map.setOpacity(opacity),
      setColour: drawn.setColour,
      zoomTo: () => view.fit(bounds),
      remove: () => this.remove(layer, drawn.map),
      publish: layer.type === "features" ? () => this.publish(layer) : null,
    };
    this.list.append(fileRow(layer, colour, actions));
    this.follow();
    view.fit(bounds, 0);
  }

  private remove(layer: FileLayer, drawn: BaseLayer): void {
    this.context.view.map.removeLayer(drawn);
    this.names.delete(drawn);
    if (layer.type === "image") URL.revokeObjectURL(layer.url);
  }

  /** Lists the attributes of the features at a place, the uppermost first. */
  private showAttributes(point: MapPoint, box: HTMLElement): void {
    const { map } = this.context.view;
    const pixel = map.getPixelFromCoordinate([...point]);
    if (!pixel) return;
    const layerFilter = (layer: BaseLayer) => this.names.has(layer);
    map.forEachFeatureAtPixel(
      pixel,
      (feature, drawn) => {
        const found = { name: this.names.get(drawn) ?? "", properties: feature.getProperties() };
        box.append(attributes(found));
      },
      { layerFilter, hitTolerance: HIT_PX },
    );
  }

  /** Writes the features as drafts, one after the other. */
  private publish(layer: FileLayer): void {
    const { waiting, mission, page } = this.context;
    if (layer.type !== "features") return;
    const drafts = annotationsOf(layer);
    if (drafts.length > MOST_PUBLISHED) {
      waiting.notify(
        `${layer.name} has ${drafts.length} features; at most ${MOST_PUBLISHED} become annotations: take fewer into the file.`,
      );
      return;
    }
    waiting.act(async () => {
      for (const draft of drafts) await edits.annotate(mission.mission, draft);
      page.toast(`${drafts.length} features of ${layer.name} are draft annotations now.`);
      page.showTab("notes");
    });
  }
}

/** Bounds of the corners on the map. */
function imageBounds({ extent, crs }: Extract<FileLayer, { type: "image" }>): Bounds {
  const [west, south, east, north] = extent;
  const corners = [
    [west, south],
    [east, south],
    [east, north],
    [west, north],
  ].map(crs.toMap);
  const side = (at: number) => corners.map((corner) => corner[at] ?? Number.NaN);
  const bounds = [
    ...[Math.min(...side(0)), Math.min(...side(1)), Math.max(...side(0)), Math.max(...side(1))],
  ] as unknown as Bounds;
  if (!bounds.every(Number.isFinite))
    throw new RefusedFile("it lies on the far side of Mars, which the local map does not show");
  return bounds;
}
