/** The layers of a mission and how each is shown: the one place that knows. */

import { firstState, type LayerState } from "../map/layers";
import type { Layer } from "../server/records";
import { Signal } from "./signal";

const OFF: LayerState = { visible: false, opacity: 1 };

export class LayerBook {
  /** A layer is shown otherwise than before. */
  readonly changed = new Signal<Layer>();
  /** The server published: there are other layers, or other products behind them. */
  readonly replaced = new Signal<readonly Layer[]>();
  private readonly states = new Map<string, LayerState>();
  private list: readonly Layer[];

  /** `on` is the opacity by id of the layers that are on; null leaves the choice to the book. */
  constructor(layers: readonly Layer[], on: ReadonlyMap<string, number> | null) {
    this.list = layers;
    for (const layer of layers) {
      const first = firstState(layer, layers);
      const opacity = on?.get(layer.id);
      const asked = { visible: opacity !== undefined, opacity: opacity ?? first.opacity };
      this.states.set(layer.id, on ? asked : first);
    }
  }

  get all(): readonly Layer[] {
    return this.list;
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
    return this.states.get(id) ?? OFF;
  }

  change(layer: Layer, part: Partial<LayerState>): void {
    this.states.set(layer.id, { ...this.state(layer), ...part });
    this.changed.emit(layer);
  }

  /** Opacity by id of the layers that are on. */
  get on(): ReadonlyMap<string, number> {
    const visible = [...this.states].filter(([, state]) => state.visible);
    return new Map(visible.map(([id, state]) => [id, state.opacity]));
  }

  /** Takes the server's new list. Layers keep how they are shown; new ones are shown as at first. */
  replace(layers: readonly Layer[]): void {
    this.list = layers;
    for (const layer of layers)
      if (!this.states.has(layer.id)) this.states.set(layer.id, firstState(layer, layers));
    this.replaced.emit(layers);
  }
}
