/** The card of a stop that was clicked, above what lies there. */

import { api } from "../../server/api";
import { network, type TraverseRow } from "../../server/network";
import { panoramaApi } from "../../server/panorama";
import type { MapPoint } from "../../server/records";
import type { Context } from "../../session/context";
import { isRefusal } from "../../session/latest";
import { stopCard } from "./card";
import "./stop-card.css";

export function stopCardPart(context: Context): void {
  const { mission, layers, view, events, waiting, signal } = context;
  events.stop.on(({ stop, point, box }) =>
    waiting.run(async () => {
      const [row, images, panoramas, features] = await Promise.all([
        rowOf(mission.mission, stop, signal),
        api.images(mission.mission, { stop }, signal),
        panoramaApi.all(mission.mission, signal),
        view.featuresOf(layers.widest("stops")),
      ]);
      const own = features.filter((feature) => feature.get("stop") === stop);
      const sols = own.flatMap((feature) => (feature.get("sols") as number[] | undefined) ?? []);
      const known = {
        mission: mission.mission,
        stop,
        sols: [...new Set(sols)].sort((a, b) => a - b),
        row,
        images,
        layers: layers.all.filter(({ scope }) => scope === stop),
      };
      const hasPanorama = panoramas.some(({ scope }) => scope === stop);
      box.replaceChildren(stopCard(known, actionsOf(context, stop, point, hasPanorama)));
    }),
  );
}

/** The stop's row of the traverse; null if it is in no adjustment. */
async function rowOf(
  mission: string,
  stop: string,
  signal: AbortSignal,
): Promise<TraverseRow | null> {
  try {
    const { rows } = await network.traverse(mission, "latest", "telemetry", signal);
    return rows.find((row) => row.stop === stop) ?? null;
  } catch (reason) {
    if (isRefusal(reason)) return null;
    throw reason;
  }
}

function actionsOf(
  { page, state, places }: Context,
  stop: string,
  point: MapPoint,
  hasPanorama: boolean,
) {
  const panorama = { stop, sight: null };
  const images = () => {
    state.set("images", stop);
    page.showTab("images");
  };
  const scene = places.offered.find(({ title }) => title === "3D here");
  return [
    { name: "Images", run: images },
    ...(hasPanorama ? [{ name: "Panorama", run: () => state.set("panorama", panorama) }] : []),
    ...(scene ? [{ name: "3D view", run: () => scene.run(point) }] : []),
  ];
}
