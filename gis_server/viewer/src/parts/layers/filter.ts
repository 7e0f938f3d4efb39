/** Which layers the tree lists: by words, by kind, and by the instrument that took the images of a stop. */

import { kindTitle } from "../../map/layers";
import { h } from "../../page/dom";
import type { ImageEntry, Layer } from "../../server/records";

/** Conditions of listed layers; null or no words: all. */
export interface Wanted {
  /** In small letters, all of them in the name of the layer or of its group. */
  readonly words: readonly string[];
  /** Title of its kind. */
  readonly kind: string | null;
  /** Scopes of the permitted stops. */
  readonly stops: ReadonlySet<string> | null;
}

export const ALL: Wanted = { words: [], kind: null, stops: null };

export const isAll = ({ words, kind, stops }: Wanted) =>
  words.length === 0 && kind === null && stops === null;

export const isWanted = (layer: Layer, group: string, { words, kind, stops }: Wanted): boolean => {
  const title = kindTitle(layer.kind);
  if (kind !== null && kind !== title) return false;
  if (stops !== null && !stops.has(layer.scope)) return false;
  const name = `${title} ${group}`.toLowerCase();
  return words.every((word) => name.includes(word));
};

type Taken = Pick<ImageEntry, "instrument" | "stop">;

export interface LayerFilter {
  readonly element: HTMLElement;
  readonly wanted: () => Wanted;
  /** Offers the kinds of these layers. */
  readonly setLayers: (layers: readonly Layer[]) => void;
}

/** `imagesOf` fetches the images of the mission: their instruments are fetched when the filter gets the focus. */
export function layerFilter(
  change: () => void,
  imagesOf: () => Promise<readonly Taken[]>,
): LayerFilter {
  const search = h("input", {
    type: "search",
    class: "layer-filter",
    placeholder: "filter layers",
    "aria-label": "filter layers",
    oninput: change,
  });
  const kind = h("select", { "aria-label": "kind of layers", onchange: change });
  let images: Promise<readonly Taken[]> | null = null;
  let taken: readonly Taken[] = [];
  const learn = () => {
    images ??= imagesOf();
    images.then(
      (found) => {
        if (taken === found) return;
        taken = found;
        fill(instrument, "all instruments", new Set(found.map((image) => image.instrument)));
      },
      () => (images = null),
    );
  };
  const instrument = h("select", {
    "aria-label": "instrument of layers",
    title: "layers of stops that this instrument photographed",
    onpointerenter: learn,
    onfocus: learn,
    onchange: change,
  });
  fill(instrument, "all instruments", new Set());
  return {
    element: h("div", { class: "layer-filters" }, search, kind, instrument),
    wanted: () => {
      const by = instrument.value;
      const stops = taken.filter((image) => image.instrument === by).map(({ stop }) => stop);
      return {
        words: search.value.toLowerCase().split(/\s+/).filter(Boolean),
        kind: kind.value || null,
        stops: by ? new Set(stops) : null,
      };
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
