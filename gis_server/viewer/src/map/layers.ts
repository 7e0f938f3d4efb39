/** Order, grouping and first state of layers. */

import { scopeTitle } from "../page/format";
import type { Bounds, Layer, Level } from "../server/records";
import type { Blend } from "./blending";
import { LISTED, ON, OPACITY, STACK } from "./kinds";
import type { RasterStyle } from "./raster-style";

export { kindTitle } from "./kinds";

export interface LayerGroup {
  readonly key: string;
  readonly title: string;
  readonly level: Level;
  readonly layers: readonly Layer[];
}

export interface LayerState {
  readonly visible: boolean;
  readonly opacity: number;
  /** Style of its values in the viewer; null: as the server draws them. */
  readonly style: RasterStyle | null;
  /** How its colours are put together with those below; null: it covers them. */
  readonly blend: Blend | null;
}

const LEVELS: readonly Level[] = ["region", "sol", "stop"];

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

/** One group per scope: the region first, then sols, then stops in driving order. */
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

const isWithin = ([west, south, east, north]: Bounds, [w, s, e, n]: Bounds) =>
  west <= (w + e) / 2 && (w + e) / 2 <= east && south <= (s + n) / 2 && (s + n) / 2 <= north;

const widerByKind = new WeakMap<readonly Layer[], Map<string, Layer[]>>();

/** Products of a kind that cover more than one stop, selected once per list. */
function widerOf(all: readonly Layer[], kind: string): readonly Layer[] {
  let known = widerByKind.get(all);
  if (!known) {
    known = new Map<string, Layer[]>();
    for (const layer of all)
      if (layer.level !== "stop") known.set(layer.kind, [...(known.get(layer.kind) ?? []), layer]);
    widerByKind.set(all, known);
  }
  return known.get(kind) ?? [];
}

/** Whether a product of a wider scope shows the same, so that this one is not needed. */
function isIn(layer: Layer, wider: Layer): boolean {
  if (LEVELS.indexOf(wider.level) >= LEVELS.indexOf(layer.level)) return false;
  const isMerged = wider.kind === `region-${layer.kind}` && isWithin(wider.bounds, layer.bounds);
  return isMerged || wider.kind === layer.kind;
}

/**
 * Layers shown at first: relief, image, contours, stops and traverse, each from the widest products there
 * are, merged ones before those of the stops; footprints and pointing lines if there is no mapped ground.
 */
export function firstState(layer: Layer, all: readonly Layer[]): LayerState {
  const wider = [layer.kind, `region-${layer.kind}`].some((kind) =>
    widerOf(all, kind).some((other) => isIn(layer, other)),
  );
  const hasGround = all.some((other) => other.type === "raster");
  const viewing = layer.kind === "footprints" || layer.kind === "pointing";
  return {
    visible: !wider && (ON.has(layer.kind) || (viewing && !hasGround)),
    opacity: OPACITY[layer.kind] ?? 1,
    style: null,
    blend: null,
  };
}

/** A layer without features has its bounds at the origin, where nothing need be. */
const isEmpty = ({ bounds }: Layer) => bounds.every((metres) => metres === 0);

/**
 * Bounds of what is shown at first; null where nothing is. Rasters end on whole blocks, so contours, where there are
 * any, bound the seen ground better.
 */
export function firstBounds(layers: readonly Layer[]): Bounds | null {
  const visible = layers.filter((layer) => firstState(layer, layers).visible && !isEmpty(layer));
  const hasContours = visible.some(({ kind }) => kind.endsWith("contours"));
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
