/** Stereo pairs beside the map: the pair of the image that is open, or the first there is. */

import { api } from "../../server/api";
import type { Context } from "../../session/context";
import { addPane } from "../../session/pane";
import { pairOf, pairsOf } from "./fuse";

export function stereoPart(context: Context): void {
  const { mission, state, waiting } = context;
  addPane(context, "stereo", {
    title: "Stereo pair",
    side: "beside",
    tool: {
      name: "stereo pair",
      picture: "eyes",
      key: "2",
      does: "stereo pair",
      class: "stereo-tool",
      first: () => ({ left: "", way: "anaglyph" as const, parallax: null, sight: null }),
    },
    load: async (write) => {
      const [{ StereoView }, images] = await Promise.all([
        import("./view"),
        api.images(mission.mission, {}),
      ]);
      const pairs = pairsOf(images);
      if (pairs.length === 0) {
        waiting.notify("no image of this mission has a stereo partner");
        return null;
      }
      const open = () => pairOf(images, state.get("image")?.id ?? "")?.left.id;
      return new StereoView(context, pairs, open, write);
    },
  });
}
