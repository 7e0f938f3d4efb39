/**
 * What the parts of a session share. A part is a function that is called once with it: it adds its tab, tools and keys
 * to the page and listens to the signals of others. Parts do not import each other.
 */

import type Feature from "ol/Feature";
import type Geometry from "ol/geom/Geometry";
import type { CoordinateFormat } from "../map/coordinates";
import type { MapView } from "../map/map-view";
import type { SunPlace } from "../map/shading";
import type { Sols } from "../map/sols";
import type { DrawingState } from "../map/styles";
import type { Shell } from "../page/shell";
import type { Account } from "../server/account";
import type { ServerEvent } from "../server/events";
import type { Layer, MapPoint, Mission } from "../server/records";
import type { Kept, LinkBook } from "./kept";
import type { LayerBook } from "./layer-book";
import type { LinkHistory } from "./link-history";
import type { PlaceActions } from "./place-actions";
import type { Shortcuts } from "./shortcuts";
import type { Signal } from "./signal";
import type { StopFrames } from "./stop-frames";
import type { Waiting } from "./waiting";

/** A place on the map that was pointed at or clicked, and the feature there. */
export interface Pointed {
  readonly point: MapPoint;
  readonly pixel: readonly number[];
  readonly touched: { readonly feature: Feature<Geometry>; readonly layer: Layer } | null;
}

export interface Signals {
  /** The pointer moved over the map; null: it left. */
  readonly pointer: Signal<Pointed | null>;
  /** The map was clicked, while no tool claims clicks. */
  readonly click: Signal<Pointed>;
  /** A place to mark on the map, in profiles, images and the 3D view alike; null: none. */
  readonly cursor: Signal<MapPoint | null>;
  /** Request to open an image, by its id. Like `compare` it waits until all parts are loaded. */
  readonly image: Signal<string>;
  /** An image to show on the map for a moment; null: no longer. */
  readonly imageHovered: Signal<string | null>;
  /** A stop was clicked: `box` receives its description. */
  readonly stop: Signal<{
    readonly stop: string;
    readonly point: MapPoint;
    readonly box: HTMLElement;
  }>;
  /** Request to list the images of a stop. */
  readonly imagesOf: Signal<string>;
  /** Request to open the panorama of a stop. */
  readonly panorama: Signal<string>;
  /** Request for the value of every layer at a place. */
  readonly identify: Signal<MapPoint>;
  /** A place is identified: `box` receives further results. */
  readonly identified: Signal<{ readonly point: MapPoint; readonly box: HTMLElement }>;
  /** The distance between places is to be measured: `box` receives the result. */
  readonly measure: Signal<{ readonly corners: readonly MapPoint[]; readonly box: HTMLElement }>;
  /** Other sols were chosen; they are in `drawing`. */
  readonly sols: Signal<Sols>;
  /** Error ellipses have a new factor. */
  readonly ellipses: Signal<number>;
  /** Two layers are to be compared, by their ids. */
  readonly compare: Signal<{ mode: "swipe" | "difference"; a: string; b: string }>;
  /** The server sent an event of the store. */
  readonly serverEvent: Signal<ServerEvent>;
  /** The connection with the server was restored. */
  readonly reconnected: Signal<void>;
  /** The view moved, or layers were switched: the link has changed. */
  readonly view: Signal<void>;
}

export interface Context {
  readonly page: Shell;
  readonly mission: Mission;
  readonly layers: LayerBook;
  readonly view: MapView;
  readonly drawing: DrawingState;
  /** Position of the sun for all shading in the viewer. */
  readonly sun: Kept<SunPlace>;
  /** Values of parts in the link. */
  readonly link: LinkBook;
  readonly history: LinkHistory;
  /** The signed-in account; null: nobody, so nothing can be written. */
  readonly account: Kept<Account | null>;
  readonly waiting: Waiting;
  readonly keys: Shortcuts;
  readonly places: PlaceActions;
  readonly frames: StopFrames;
  /** How longitude and latitude are shown; kept in the browser. */
  readonly coordinates: Kept<CoordinateFormat>;
  readonly signals: Signals;
  /** Number of the last event included when the page was loaded; null: unknown. */
  readonly lastEvent: string | null;
  /** Ends when the session does: for listeners and requests. */
  readonly alive: AbortSignal;
}

export type Part = (context: Context) => void;
