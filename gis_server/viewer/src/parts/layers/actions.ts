/** Actions on layers in their lists. */

import type { Blend } from "../../map/blending";
import type { LayerState } from "../../map/layers";
import type { RasterStyle } from "../../map/raster-style";
import type { Layer, RasterLayer } from "../../server/records";
import type { LayerVersions } from "../../server/versions";

export interface LayerActions {
  readonly stateOf: (layer: Layer) => LayerState;
  readonly setVisible: (layer: Layer, visible: boolean) => void;
  readonly setOpacity: (layer: Layer, opacity: number) => void;
  readonly setBlend: (layer: Layer, blend: Blend | null) => void;
  readonly setStyle: (layer: RasterLayer, style: RasterStyle | null) => void;
  /** Stretches the colours over the values on the screen. */
  readonly stretch: (layer: RasterLayer) => void;
  /** Black and white are percentiles of the shades on the screen. */
  readonly stretchImagery: (layer: RasterLayer, share: number) => void;
  readonly zoomTo: (layer: Layer) => void;
  readonly showProvenance: (layer: Layer) => void;
  readonly ellipseFactor: () => number;
  readonly setEllipseFactor: (factor: number) => void;
  /** Elevations of the contours of a layer that were fetched. */
  readonly elevationsOf: (layer: Layer) => readonly number[];
  /** Puts a layer over the next one on the map, or below it. */
  readonly move: (layer: Layer, step: 1 | -1) => void;
  readonly place: (layer: Pick<Layer, "id">, beside: Layer, step: 1 | -1) => void;
  /** The layer that is shown alone or flickers; null: none. */
  readonly solo: () => string | null;
  readonly flickering: () => string | null;
  readonly toggleSolo: (layer: Layer) => void;
  readonly toggleFlicker: (layer: Layer) => void;
  /** Versions of a layer, newest first, from some number on. */
  readonly versions: (layer: Layer, from: number) => Promise<LayerVersions>;
  readonly isThere: (version: Layer) => boolean;
  /** Adds an earlier version to the map, and removes it. */
  readonly add: (version: Layer) => void;
  readonly dismiss: (version: Layer) => void;
  /** Compares an earlier version with the latest one. */
  readonly compare: (
    version: Layer,
    latest: Layer,
    how: "swipe" | "difference" | "flicker",
  ) => void;
}

/** An element of a list that follows changes of its layer. */
export interface Following {
  readonly element: HTMLElement;
  readonly follow: () => void;
}
