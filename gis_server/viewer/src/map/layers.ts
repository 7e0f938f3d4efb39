/** Order, grouping and first state of layers. */

import { scopeTitle } from "../page/format";
import type { Bounds, Layer, Level } from "../server/records";

export interface LayerGroup {
  readonly key: string;
  readonly title: string;
  readonly level: Level;
  readonly layers: readonly Layer[];
}

export interface LayerState {
  readonly visible: boolean;
  readonly opacity: number;
}

/** From the bottom of the map to its top: what a layer says lies above what the ground looks like. */
const STACK = [
  "orbital",
  "far-hillshade",
  "far-dtm",
  "region-hillshade",
  "hillshade",
  "orthophoto",
  "colour",
  "sources",
  "region-dtm",
  "dtm",
  "uncertainty",
  "region-slope",
  "slope",
  "region-aspect",
  "aspect",
  "region-northerly-tilt",
  "northerly-tilt",
  "region-roughness",
  "roughness",
  "region-insolation",
  "insolation",
  "viewshed",
  "region-hazard",
  "hazard",
  "region-seams",
  "region-havens",
  "havens",
  "footprints",
  "far-contours",
  "region-contours",
  "contours",
  "pointing",
  "tie-points",
  "dips",
  "mission-traverse",
  "mission-stops",
  "traverse",
  "stops",
];

const LISTED = [
  "stops",
  "traverse",
  "mission-traverse",
  "mission-stops",
  "contours",
  "pointing",
  "footprints",
  "tie-points",
  "dips",
  "orthophoto",
  "colour",
  "sources",
  "hillshade",
  "dtm",
  "slope",
  "aspect",
  "northerly-tilt",
  "roughness",
  "insolation",
  "havens",
  "viewshed",
  "hazard",
  "region-contours",
  "region-hillshade",
  "region-dtm",
  "region-slope",
  "region-aspect",
  "region-northerly-tilt",
  "region-roughness",
  "region-insolation",
  "region-havens",
  "region-hazard",
  "region-seams",
  "far-contours",
  "far-hillshade",
  "far-dtm",
  "orbital",
];

const LEVELS: readonly Level[] = ["region", "sol", "stop"];
const ON = new Set([
  "orbital",
  "hillshade",
  "orthophoto",
  "contours",
  "traverse",
  "stops",
  "mission-traverse",
]);
const OPACITY: Readonly<Record<string, number>> = {
  orthophoto: 0.8,
  sources: 0.6,
  dtm: 0.6,
  "far-dtm": 0.6,
  "region-dtm": 0.6,
  "region-slope": 0.6,
  "region-aspect": 0.6,
  "region-northerly-tilt": 0.6,
  "region-roughness": 0.6,
  "region-insolation": 0.6,
  "region-hazard": 0.5,
  "region-seams": 0.6,
  slope: 0.6,
  aspect: 0.6,
  "northerly-tilt": 0.6,
  roughness: 0.6,
  insolation: 0.6,
  viewshed: 0.5,
  hazard: 0.5,
};

const KIND_TITLES: Readonly<Record<string, string>> = {
  dtm: "Elevation (DTM)",
  orthophoto: "Orthophoto",
  slope: "Slope",
  aspect: "Aspect",
  "northerly-tilt": "Northerly tilt",
  roughness: "Roughness",
  insolation: "Insolation",
  havens: "Winter havens",
  viewshed: "Seen from the stop",
  hazard: "Hazards to a rover",
  hillshade: "Hillshade",
  contours: "Contours",
  "far-dtm": "Far elevation (DTM)",
  "region-dtm": "Elevation (DTM)",
  "region-hillshade": "Hillshade",
  "region-slope": "Slope",
  "region-aspect": "Aspect",
  "region-northerly-tilt": "Northerly tilt",
  "region-roughness": "Roughness",
  "region-insolation": "Insolation",
  "region-havens": "Winter havens",
  "region-hazard": "Hazards to a rover",
  "region-seams": "Disagreement of stops",
  "region-contours": "Contours",
  "far-hillshade": "Far hillshade",
  "far-contours": "Far contours",
  orbital: "Orbital image",
  traverse: "Traverse",
  "mission-traverse": "Whole traverse",
  "mission-stops": "Stops of the whole traverse",
  stops: "Stops",
  footprints: "Image footprints",
  pointing: "Pointing lines",
  "tie-points": "Tie points",
  dips: "Strike and dip",
};

export function kindTitle(kind: string): string {
  return KIND_TITLES[kind] ?? kind.charAt(0).toUpperCase() + kind.slice(1).replaceAll("-", " ");
}

const rank = (order: readonly string[], kind: string) => {
  const place = order.indexOf(kind);
  return place < 0 ? order.length : place;
};

/** Place in the stack of the map; wide products lie under the close ones of their kind. */
export function zIndex(layer: Pick<Layer, "kind" | "level">): number {
  return 10 * rank(STACK, layer.kind) + LEVELS.indexOf(layer.level);
}

function compareGroups(a: LayerGroup, b: LayerGroup): number {
  const level = LEVELS.indexOf(a.level) - LEVELS.indexOf(b.level);
  return level || a.key.localeCompare(b.key, "en", { numeric: true });
}

/** One group a scope: the region first, then sols, then stops in the order they were driven to. */
export function groupLayers(layers: readonly Layer[]): readonly LayerGroup[] {
  const scopes = new Map<string, Layer[]>();
  for (const layer of layers) {
    const members = scopes.get(layer.scope);
    if (members) members.push(layer);
    else scopes.set(layer.scope, [layer]);
  }
  return [...scopes.entries()]
    .map(([key, members]): LayerGroup => {
      const level = members[0]?.level ?? "region";
      return {
        key,
        level,
        title: scopeTitle(key),
        layers: members.sort((a, b) => rank(LISTED, a.kind) - rank(LISTED, b.kind)),
      };
    })
    .sort(compareGroups);
}

/**
 * What is shown at first: relief, image, contours, stops and traverse, each from the widest products there
 * are; footprints and pointing lines where there is no ground to look at.
 */
export function firstState(layer: Layer, all: readonly Layer[]): LayerState {
  const wider = all.some(
    (other) =>
      other.kind === layer.kind && LEVELS.indexOf(other.level) < LEVELS.indexOf(layer.level),
  );
  const hasGround = all.some((other) => other.type === "raster");
  const viewing = layer.kind === "footprints" || layer.kind === "pointing";
  return {
    visible: !wider && (ON.has(layer.kind) || (viewing && !hasGround)),
    opacity: OPACITY[layer.kind] ?? 1,
  };
}

/** A layer without features has its bounds at the origin, where nothing need be. */
const isEmpty = ({ bounds }: Layer) => bounds.every((metres) => metres === 0);

/**
 * Bounds of what is shown at first; null where nothing is. Rasters end on whole blocks, so where there are contours the
 * lines say better how far the ground was seen.
 */
export function firstBounds(layers: readonly Layer[]): Bounds | null {
  const visible = layers.filter((layer) => firstState(layer, layers).visible && !isEmpty(layer));
  const hasContours = visible.some(({ kind }) => kind === "contours");
  const shown = visible
    .filter(({ type }) => !hasContours || type === "vector")
    .map(({ bounds }) => bounds);
  if (shown.length === 0) return null;
  return [
    Math.min(...shown.map(([west]) => west)),
    Math.min(...shown.map(([, south]) => south)),
    Math.max(...shown.map(([, , east]) => east)),
    Math.max(...shown.map(([, , , north]) => north)),
  ];
}
