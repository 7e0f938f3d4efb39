/** One box that goes to a sol, site, stop, image or place by its name. */

import type Feature from "ol/Feature";
import type Geometry from "ol/geom/Geometry";
import type { References } from "../../map/coordinates";
import { ImageFeatures } from "../../map/image-features";
import { firstBounds } from "../../map/layers";
import { api } from "../../server/api";
import type { Bounds, MapPoint } from "../../server/records";
import { type Context, openImage } from "../../session/context";
import { searchBox } from "./box";
import { type Entry, entriesOf, find, type Goal, type StopFacts } from "./find";
import "./search.css";

/** Half the width of the ground shown around a stop or place, metres. */
const AROUND_M = 12;

export function searchPart(context: Context): void {
  const { page, keys, layers, waiting, mission, view, frames } = context;
  let entries: readonly Entry[] | null = null;
  let to: References = { local: view.local, bounds: null, frames: null };
  const load = async () => {
    const [stops, images, known] = await Promise.all([
      stopFeatures(context),
      api.images(mission.mission, {}),
      frames.load(),
    ]);
    to = { ...to, bounds: firstBounds(layers.all) ?? mission.bounds, frames: known };
    const sols = layers.all.flatMap((layer) => [...layer.sols]);
    entries = entriesOf(sols, stops.map(factsOf), images);
    box.refresh();
  };
  const box = searchBox({
    find: (text) => (entries ? find(entries, text, undefined, to) : []),
    entered: () => {
      if (!entries) waiting.run(load);
    },
    go: ({ goal }) => waiting.run(() => go(context, goal)),
  });
  layers.replaced.on(() => {
    entries = null;
  });
  page.searchBox.replaceChildren(box.element);
  keys.add("/", "search for a sol, site, stop, image or coordinates", () => box.focus());
}

function stopFeatures({ view, layers }: Context): Promise<Feature<Geometry>[]> {
  return view.featuresOf(layers.widest("stops"));
}

const factsOf = (feature: Feature<Geometry>): StopFacts => ({
  stop: String(feature.get("stop")),
  site: Number(feature.get("site")),
  drive: Number(feature.get("drive")),
});

async function go(context: Context, goal: Goal): Promise<void> {
  const { events, state } = context;
  switch (goal.to) {
    case "sol":
      state.set("sol", [goal.sol, goal.sol]);
      fitTo(context, solBounds(context, goal.sol) ?? (await stopsBounds(context, () => true)));
      return;
    case "site":
      fitTo(context, await stopsBounds(context, ({ site }) => site === goal.site));
      return;
    case "stop":
      fitTo(context, await stopsBounds(context, ({ stop }) => stop === goal.stop));
      return;
    case "image":
      openImage(context, goal.image);
      fitTo(
        context,
        (await imageBounds(context, goal.image)) ??
          (await stopsBounds(context, ({ stop }) => stop === goal.stop)),
      );
      return;
    case "place":
      events.cursor.emit(goal.point);
      fitTo(context, around(goal.point));
      return;
    default:
      throw new Error(`unknown goal ${JSON.stringify(goal satisfies never)}`);
  }
}

function fitTo({ view, waiting }: Context, bounds: Bounds | null): void {
  if (bounds) view.fit(bounds);
  else waiting.notify("it is not on the map: no stop or footprint of it is published");
}

const around = ([east, north]: MapPoint): Bounds => [
  east - AROUND_M,
  north - AROUND_M,
  east + AROUND_M,
  north + AROUND_M,
];

function union(boxes: readonly (readonly number[])[]): Bounds | null {
  const side = (at: number) => boxes.map((box) => box[at] ?? Number.NaN);
  if (boxes.length === 0) return null;
  return [Math.min(...side(0)), Math.min(...side(1)), Math.max(...side(2)), Math.max(...side(3))];
}

/** Bounds of what was mapped on a sol, from stops and sols alone: regions are of many sols. */
function solBounds({ layers }: Context, sol: number): Bounds | null {
  const filled = layers.all.filter(
    ({ sols, level, bounds }) => level !== "region" && sols.includes(sol) && bounds.some(Boolean),
  );
  const lines = filled.filter(({ kind }) => kind === "contours"); // rasters end on whole blocks
  return union((lines.length > 0 ? lines : filled).map(({ bounds }) => bounds));
}

/** Bounds of some stops and of the ground around them. */
async function stopsBounds(
  context: Context,
  holds: (facts: StopFacts) => boolean,
): Promise<Bounds | null> {
  const stops = (await stopFeatures(context)).filter((feature) => holds(factsOf(feature)));
  const adjusted = stops.filter((feature) => feature.get("solution") !== "telemetry");
  const places = (adjusted.length > 0 ? adjusted : stops).map((feature) => {
    const [east = 0, north = 0] = feature.getGeometry()?.getExtent() ?? [];
    return around([east, north]);
  });
  return union(places);
}

async function imageBounds({ layers }: Context, id: string): Promise<Bounds | null> {
  const viewing = [...layers.widest("footprints"), ...layers.widest("pointing")];
  const own = await new ImageFeatures(() => viewing).of(id);
  return union(own.map((feature) => feature.getGeometry()?.getExtent() ?? []));
}
