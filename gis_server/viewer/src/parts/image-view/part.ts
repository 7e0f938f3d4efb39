/**
 * The chosen original image beside the map; the map's cursor is shown in the image and the image's cursor on the map.
 */

import "./image-view.css";
import { api } from "../../server/api";
import type { ImageEntry } from "../../server/records";
import type { Context } from "../../session/context";
import { addPane } from "../../session/pane";
import { ImageViewer } from "./viewer";

export function imageViewPart(context: Context): void {
  const { events, mission, layers, view } = context;
  let viewer: ImageViewer | null = null;
  let known: Promise<ReadonlyMap<string, ImageEntry>> | null = null;

  const images = () => {
    known ??= api
      .images(mission.mission, {})
      .then((all) => new Map(all.map((image) => [image.id, image] as const)));
    return known;
  };
  addPane(context, "image", {
    title: "Image",
    side: "beside",
    load: async (write) => {
      const all = await images();
      const { state, waiting } = context;
      const requested = state.get("image")?.id ?? "";
      if (!all.has(requested)) {
        waiting.notify(`The server lists no image ${requested}.`);
        return null;
      }
      const opened = new ImageViewer(context, write);
      viewer = opened;
      return {
        element: opened.element,
        get title() {
          return state.get("image")?.id ?? "";
        },
        show: async ({ id, sight }) => {
          const image = (await images()).get(id);
          if (image) await opened.open(image, sight);
        },
        dispose: () => {
          opened.close();
          viewer = null;
        },
      };
    },
  });
  events.pointer.on((pointed) => {
    if (pointed && !view.isClaimed) viewer?.mark(pointed.point);
  });
  events.cursor.on((point) => {
    if (point) viewer?.mark(point);
  });
  layers.replaced.on(() => {
    known = null;
  });
}
