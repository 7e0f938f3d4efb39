/** The layers of a mission, how each is shown and in which order: the only place that records this. */

import { bandsOf } from "../map/bands";
import { firstState, type LayerState, zIndex } from "../map/layers";
import { ownStyle } from "../map/raster-style";
import { areIn, type Sols } from "../map/sols";
import type { Layer } from "../server/records";
import { Signal } from "./signal";
import type { LinkedLayers } from "./state";

const OFF: LayerState = { visible: false, opacity: 1, style: null, blend: null };
/** Layers lie below this height on the map; highlights and marks above. */
const TOP = 900;

export class LayerList {
  /** A layer is shown otherwise than before. */
  readonly changed = new Signal<Layer>();
  /** Other layers lie on top, or another one is shown alone. */
  readonly rearranged = new Signal<void>();
  /** The server published new layers, or new products of layers. */
  readonly replaced = new Signal<readonly Layer[]>();
  /** An earlier version of a layer was added or removed. */
  readonly versionsChanged = new Signal<void>();
  private readonly versions = new Map<string, Layer>();
  private readonly states = new Map<string, LayerState>();
  private list: readonly Layer[];
  private bands: readonly Layer[];
  /** Ids of all layers from the bottom of the map to its top. */
  private stack: readonly string[] = [];
  private heights: ReadonlyMap<string, number> = new Map();
  private isStackedByUser = false;
  private soloed: string | null = null;

  /** `on` are the layers of a link; null leaves the choice to the list. `stacked`: its order counts. */
  constructor(
    layers: readonly Layer[],
    private linked: LinkedLayers | null,
    stacked = false,
  ) {
    const on = linked;
    this.list = layers;
    this.bands = layers.flatMap(bandsOf);
    for (const layer of this.listed) {
      const first = firstState(layer, layers);
      const stateInLink = on?.get(layer.id);
      this.states.set(
        layer.id,
        on ? { ...first, ...stateInLink, visible: stateInLink !== undefined } : first,
      );
    }
    this.restack([...(stacked && on ? on.keys() : [])]);
    this.isStackedByUser = stacked;
  }

  /** The latest of every layer. */
  get all(): readonly Layer[] {
    return this.list;
  }

  /** The latest, and their bands that are layers of their own. */
  get listed(): readonly Layer[] {
    return [...this.list, ...this.bands];
  }

  /** All layers, and the earlier versions that were added. */
  get every(): readonly Layer[] {
    return [...this.listed, ...this.versions.values()];
  }

  /** Shows the layers of a link, and nothing else. `stacked`: its order counts. */
  follow(linked: LinkedLayers, stacked: boolean): void {
    this.linked = linked;
    const wasStackedByUser = this.isStackedByUser;
    for (const layer of this.every) {
      const [state, stateInLink] = [this.state(layer), linked.get(layer.id)];
      const target = stateInLink ? { ...stateInLink, visible: true } : { ...state, visible: false };
      if (JSON.stringify(target) === JSON.stringify({ ...target, ...state })) continue;
      this.change(layer, target);
    }
    if (!stacked && !wasStackedByUser) return;
    this.isStackedByUser = stacked;
    this.restack(stacked ? [...linked.keys()] : []);
    this.rearranged.emit();
  }

  /** Ids in the link that are not in the server's list: of earlier versions, or unknown. */
  get missing(): readonly string[] {
    return [...(this.linked?.keys() ?? [])].filter((id) => !this.states.has(id));
  }

  /** Adds an earlier version directly above the latest one; shown with the settings of the link, or like the latest. */
  addVersion(version: Layer): void {
    if (this.versions.has(version.id)) return;
    const latest = this.list.find(
      ({ kind, scope }) => kind === version.kind && scope === version.scope,
    );
    const like = latest ? this.state(latest) : OFF;
    const stateInLink = this.linked?.get(version.id);
    this.versions.set(version.id, version);
    if (!this.states.has(version.id))
      this.states.set(version.id, { ...like, ...stateInLink, visible: stateInLink !== undefined });
    const at = latest ? this.stack.indexOf(latest.id) + 1 : this.stack.length;
    this.setStack(this.stack.toSpliced(at, 0, version.id));
    this.versionsChanged.emit();
  }

  dismiss(version: Layer): void {
    if (!this.versions.delete(version.id)) return;
    this.states.delete(version.id);
    this.setStack(this.stack.filter((id) => id !== version.id));
    this.versionsChanged.emit();
  }

  of(kind: string): readonly Layer[] {
    return this.list.filter((layer) => layer.kind === kind);
  }

  /** Layers of a kind from the widest scope that has any: of the region, else of sols, else of stops. */
  widest(kind: string): readonly Layer[] {
    const some = this.of(kind);
    const level = ["region", "sol", "stop"].find((name) => some.some((one) => one.level === name));
    return some.filter((layer) => layer.level === level);
  }

  state({ id }: Pick<Layer, "id">): LayerState {
    const state = this.states.get(id) ?? OFF;
    return state.style ? state : { ...state, style: ownStyle(id) };
  }

  change(layer: Layer, part: Partial<LayerState>): void {
    this.states.set(layer.id, { ...this.state(layer), ...part });
    this.changed.emit(layer);
    if (this.soloed === layer.id && !this.state(layer).visible) this.setSolo(null);
  }

  /** Layers that are on, the uppermost first. */
  get shown(): readonly Layer[] {
    const layers = new Map(this.every.map((layer) => [layer.id, layer] as const));
    return this.stack
      .toReversed()
      .map((id) => layers.get(id))
      .filter((layer) => layer !== undefined)
      .filter((layer) => this.state(layer).visible);
  }

  /** Height of a layer on the map, 0 at the bottom. */
  height({ id }: Pick<Layer, "id">): number {
    return this.heights.get(id) ?? 0;
  }

  /** Puts a layer that is on over the next one that is on (1), or below it (-1). */
  move(layer: Layer, step: 1 | -1): void {
    const shown = this.shown;
    const other = shown[shown.findIndex(({ id }) => id === layer.id) - step];
    if (other) this.place(layer, other, step);
  }

  /** Puts a layer right over another one (1), or right below it (-1). */
  place(layer: Pick<Layer, "id">, beside: Pick<Layer, "id">, step: 1 | -1): void {
    if (layer.id === beside.id) return;
    const others = this.stack.filter((id) => id !== layer.id);
    const at = others.indexOf(beside.id) + (step === 1 ? 1 : 0);
    this.setStack(others.toSpliced(at, 0, layer.id));
    this.isStackedByUser = true;
    this.rearranged.emit();
  }

  /** Whether the order is another than the usual one. */
  get isRearranged(): boolean {
    return this.isStackedByUser;
  }

  /** The only layer to be drawn; null: all that are on. */
  get solo(): string | null {
    return this.soloed;
  }

  setSolo(layer: Layer | null): void {
    this.soloed = layer?.id ?? null;
    this.rearranged.emit();
  }

  /** Whether a layer is drawn when only products of some sols are looked at. */
  isDrawn(layer: Layer, range: Sols): boolean {
    if (this.soloed !== null && this.soloed !== layer.id) return false;
    return this.state(layer).visible && areIn(layer.sols, range);
  }

  /** How the layers that are on are shown, from the bottom of the map to its top. */
  get on(): LinkedLayers {
    return new Map(
      this.shown.toReversed().map((layer) => {
        const { opacity, style, blend } = this.state(layer);
        return [layer.id, { opacity, style, blend }] as const;
      }),
    );
  }

  /** Takes the server's new list. Layers keep how they are shown; new ones are shown as at first. */
  replace(layers: readonly Layer[]): void {
    const order = this.isStackedByUser ? [...this.on.keys()] : [];
    this.list = layers;
    this.bands = layers.flatMap(bandsOf);
    for (const layer of this.listed)
      if (!this.states.has(layer.id)) this.states.set(layer.id, firstState(layer, layers));
    this.restack(order);
    this.replaced.emit(layers);
  }

  /** The usual order, in which `first` take their places among themselves in the order given. */
  private restack(first: readonly string[]): void {
    const usual = this.every.toSorted((a, b) => zIndex(a) - zIndex(b)).map(({ id }) => id);
    const known = new Set(usual);
    const target = first.filter((id) => known.has(id));
    const moved = new Set(target);
    this.setStack(usual.map((id) => (moved.has(id) ? (target.shift() ?? id) : id)));
  }

  private setStack(ids: readonly string[]): void {
    this.stack = ids;
    this.heights = new Map(ids.map((id, place) => [id, (TOP * place) / ids.length] as const));
  }
}
