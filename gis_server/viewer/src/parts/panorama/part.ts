/** The panorama of a stop below the map, opened on request. */

import { panoramaApi } from "../../server/panorama";
import type { Context } from "../../session/context";
import { addPane } from "../../session/pane";

export function panoramaPart(context: Context): void {
  const { signal, waiting, mission } = context;
  addPane(context, "panorama", {
    title: "Panorama",
    side: "below",
    tool: {
      name: "panorama",
      picture: "panorama",
      key: "p",
      does: "panorama of the nearest stop",
      class: "panorama-tool",
      first: () => ({ stop: "", sight: null }),
    },
    load: async (write) => {
      const [{ PanoramaView }, panoramas] = await Promise.all([
        import("./view"),
        panoramaApi.all(mission.mission, signal),
      ]);
      if (panoramas.length > 0) return new PanoramaView(context, panoramas, write);
      waiting.notify(
        "no stop of this mission has a panorama yet: see `[panoramas]` of the pipeline",
      );
      return null;
    },
  });
}
