/** Filter of the layers that the tree lists: by words, by kind, and by the instrument that took the images of a stop. */

import { kindTitle } from "../../map/layers";
import { h } from "../../page/dom";
import type { ImageEntry, Layer } from "../../server/records";
import type { LayerFilter } from "../../session/state";

/** Conditions of listed layers; null or no words: all. */
export interface LayerCondition {
  /** Lower-case words that must all occur in the names of the layer, its kind or its group. */
  readonly words: readonly string[];
  /** Title of its kind. */
  readonly kind: string | null;
  /** Scopes of the permitted stops. */
  readonly stops: ReadonlySet<string> | null;
}

export const ALL: LayerCondition = { words: [], kind: null, stops: null };

export const isAll = ({ words, kind, stops }: LayerCondition) =>
  words.length === 0 && kind === null && stops === null;

export const matches = (
  layer: Layer,
  group: string,
  { words, kind, stops }: LayerCondition,
): boolean => {
  const title = kindTitle(layer.kind);
  if (kind !== null && kind !== title) return false;
  if (stops !== null && !stops.has(layer.scope)) return false;
  const name = `${title} ${layer.kind} ${group}`.toLowerCase();
  return words.every((word) => name.includes(word));
};

type Taken = Pick<ImageEntry, "instrument" | "stop">;

export interface FilterBox {
  readonly element: HTMLElement;
  readonly condition: () => LayerCondition;
  readonly show: (chosen: LayerFilter) => void;
  readonly focus: () => void;
  /** Offers the kinds of these layers. */
  readonly setLayers: (layers: readonly Layer[]) => void;
}

/** `imagesOf` fetches the images of the mission, of which the instruments are offered when one may be chosen. */
export function layerFilter(
  chosen: (filter: LayerFilter) => void,
  find: (condition: LayerCondition) => void,
  imagesOf: () => Promise<readonly Taken[]>,
): FilterBox {
  const now = (): LayerFilter => ({
    words: search.value,
    kind: kind.value,
    instrument: instrument.value,
  });
  const change = () => {
    chosen(now());
    find(condition());
  };
  const search = h("input", {
    type: "search",
    class: "layer-filter",
    placeholder: "filter layers",
    title: "filter layers (l)",
    "aria-label": "filter layers",
    oninput: change,
  });
  const kind = h("select", { "aria-label": "kind of layers", onchange: change });
  let images: Promise<readonly Taken[]> | null = null;
  let taken: readonly Taken[] = [];
  const loadInstruments = () => {
    images ??= imagesOf();
    return images.then(
      (found) => {
        if (taken === found) return;
        taken = found;
        fill(instrument, "all instruments", new Set(found.map((image) => image.instrument)));
      },
      () => void (images = null),
    );
  };
  const instrument = h("select", {
    "aria-label": "instrument of layers",
    title: "layers of stops that this instrument photographed",
    onpointerenter: loadInstruments,
    onfocus: loadInstruments,
    onchange: change,
  });
  fill(instrument, "all instruments", new Set());
  const condition = (): LayerCondition => {
    const { words, kind, instrument } = now();
    const stops = taken.filter((image) => image.instrument === instrument).map(({ stop }) => stop);
    return {
      words: words.toLowerCase().split(/\s+/).filter(Boolean),
      kind: kind || null,
      stops: instrument ? new Set(stops) : null,
    };
  };
  const put = (select: HTMLSelectElement, value: string) => {
    if (value && ![...select.options].some((option) => option.value === value))
      select.append(h("option", { value }, value));
    select.value = value;
  };
  return {
    element: h("div", { class: "layer-filters" }, search, kind, instrument),
    condition,
    focus: () => search.focus(),
    show: (filter) => {
      search.value = filter.words;
      put(kind, filter.kind);
      put(instrument, filter.instrument);
      find(condition());
      if (filter.instrument) void loadInstruments().then(() => find(condition()));
    },
    setLayers: (layers) => {
      images = null; // there may be others
      fill(kind, "all kinds", new Set(layers.map((layer) => kindTitle(layer.kind))));
    },
  };
}

/** Keeps the choice if it is still offered. */
function fill(select: HTMLSelectElement, all: string, values: ReadonlySet<string>): void {
  const chosen = select.value;
  const options = [...values].sort().map((value) => h("option", { value }, value));
  select.replaceChildren(h("option", { value: "" }, all), ...options);
  select.value = values.has(chosen) ? chosen : "";
}
