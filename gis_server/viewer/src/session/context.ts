/**
 * Resources that the parts of a session share. A part is a function that is called once with it: it adds its tab, tools and keys
 * to the page and listens to the events of others. Parts do not import each other.
 */

import type Feature from "ol/Feature";
import type Geometry from "ol/geom/Geometry";
import type { CoordinateFormat } from "../map/coordinates";
import type { MapView } from "../map/map-view";
import type { SunPlace } from "../map/shading";
import type { DrawingState } from "../map/styles";
import type { Shell } from "../page/shell";
import type { Account } from "../server/account";
import type { ServerEvent } from "../server/events";
import type { Layer, MapPoint, Mission } from "../server/records";
import type { Observable } from "./observable";
import type { LayerList } from "./layer-list";
import type { LinkHistory } from "./link-history";
import type { PlaceActions } from "./place-actions";
import type { Shortcuts } from "./shortcuts";
import type { Signal } from "./signal";
import type { StopFrames } from "./stop-frames";
import type { Store } from "./store";
import type { Waiting } from "./waiting";

/** A place on the map that was pointed at or clicked, and the feature there. */
export interface Pointed {
  readonly point: MapPoint;
  readonly pixel: readonly number[];
  readonly touched: { readonly feature: Feature<Geometry>; readonly layer: Layer } | null;
}

export interface Events {
  /** The pointer moved over the map; null: it left. */
  readonly pointer: Signal<Pointed | null>;
  /** The map was clicked, not to draw on it. */
  readonly click: Signal<Pointed>;
  /** A place to mark on the map, in profiles, images and the 3D view alike; null: none. */
  readonly cursor: Signal<MapPoint | null>;
  /** An image to show on the map for a moment; null: no longer. */
  readonly imageHovered: Signal<string | null>;
  /** A stop was clicked: `box` receives its description. */
  readonly stop: Signal<{
    readonly stop: string;
    readonly point: MapPoint;
    readonly box: HTMLElement;
  }>;
  /** A place is identified: `box` receives further facts about it. */
  readonly identified: Signal<{ readonly point: MapPoint; readonly box: HTMLElement }>;
  /** The distance between places is to be measured: `box` receives the result. */
  readonly measure: Signal<{ readonly corners: readonly MapPoint[]; readonly box: HTMLElement }>;
  /** Factor by which error ellipses are enlarged. */
  readonly ellipses: Signal<number>;
  /** The server sent an event of the store. */
  readonly serverEvent: Signal<ServerEvent>;
  /** The connection with the server was restored. */
  readonly reconnected: Signal<void>;
}

export interface Context {
  readonly page: Shell;
  readonly mission: Mission;
  readonly layers: LayerList;
  readonly view: MapView;
  readonly drawing: DrawingState;
  /** Position of the sun for all shading in the viewer. */
  readonly sun: Observable<SunPlace>;
  /** State of the view, as it is written in links. */
  readonly state: Store;
  readonly history: LinkHistory;
  /** The signed-in account; null: signed out, nothing can be written. */
  readonly account: Observable<Account | null>;
  readonly waiting: Waiting;
  readonly keys: Shortcuts;
  readonly places: PlaceActions;
  readonly frames: StopFrames;
  /** How longitude and latitude are shown; kept in the browser. */
  readonly coordinates: Observable<CoordinateFormat>;
  readonly events: Events;
  /** Number of the last event included when the page was loaded; null: unknown. */
  readonly lastEvent: string | null;
  /** Aborted when the session ends; for listeners and requests. */
  readonly signal: AbortSignal;
}

type Opening = Pick<Context, "page" | "state">;

/** Opens an image beside the map, and what is known of it in its tab. */
export function openImage({ page, state }: Opening, id: string): void {
  page.showTab("images");
  if (state.get("image")?.id !== id) state.set("image", { id, sight: null });
}

/** Identifies a place in its tab, and the stop there if one was clicked. */
export function identify({ page, state }: Opening, at: MapPoint, stop: string | null = null): void {
  page.showTab("point"); // at once: a tab chosen meanwhile stays open
  state.set("stop", stop);
  state.set("pt", at);
}

export type Part = (context: Context) => void;
