/** What can be done with layers in their lists. */

import type { LayerState } from "../../map/layers";
import type { RasterStyle } from "../../map/raster-style";
import type { Layer, RasterLayer } from "../../server/records";

export interface LayerActions {
  readonly stateOf: (layer: Layer) => LayerState;
  readonly setVisible: (layer: Layer, visible: boolean) => void;
  readonly setOpacity: (layer: Layer, opacity: number) => void;
  readonly setStyle: (layer: RasterLayer, style: RasterStyle | null) => void;
  /** Spreads the colours over what is on the screen. */
  readonly stretch: (layer: RasterLayer) => void;
  readonly zoomTo: (layer: Layer) => void;
  readonly showProvenance: (layer: Layer) => void;
  readonly ellipseFactor: () => number;
  readonly setEllipseFactor: (factor: number) => void;
  /** Puts a layer over the next one on the map, or below it. */
  readonly move: (layer: Layer, step: 1 | -1) => void;
  readonly place: (layer: Pick<Layer, "id">, beside: Layer, step: 1 | -1) => void;
  /** The layer that is shown alone or flickers; null: none. */
  readonly solo: () => string | null;
  readonly flickering: () => string | null;
  readonly toggleSolo: (layer: Layer) => void;
  readonly toggleFlicker: (layer: Layer) => void;
}

/** Something in a list that follows what becomes of its layer. */
export interface Following {
  readonly element: HTMLElement;
  readonly follow: () => void;
}
