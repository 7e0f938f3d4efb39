/**
 * The chosen original image beside the map; the map's cursor is shown in the image and the image's cursor on the map.
 */

import "./image-view.css";
import type { Pane } from "../../page/panes";
import { api } from "../../server/api";
import type { ImageEntry } from "../../server/records";
import type { Context } from "../../session/context";
import { ImageViewer } from "./viewer";

const KEY = "image";

export function imageViewPart(context: Context): void {
  const { page, signals, mission, layers, waiting, view, link } = context;
  let viewer: ImageViewer | null = null;
  let pane: Pane | null = null;
  let known: Promise<ReadonlyMap<string, ImageEntry>> | null = null;

  const images = () => {
    known ??= api
      .images(mission.mission, {})
      .then((all) => new Map(all.map((image) => [image.id, image] as const)));
    return known;
  };
  const open = async (id: string) => {
    const image = (await images()).get(id);
    if (!image) return; // the list of images shows that
    viewer ??= new ImageViewer(context);
    const current = viewer;
    pane ??= page.panes.open(id, current.element, () => {
      current.close();
      viewer = pane = null;
      link.write(KEY, null);
    });
    link.write(KEY, id);
    pane.title(id);
    await current.open(image);
  };

  signals.image.on((id) => waiting.run(() => open(id)));
  link.follow(KEY, (id) => {
    if (id) waiting.run(() => open(id));
    else pane?.close();
  });
  signals.pointer.on((pointed) => {
    if (pointed && !view.isClaimed) viewer?.mark(pointed.point);
  });
  signals.cursor.on((point) => {
    if (point) viewer?.mark(point);
  });
  layers.replaced.on(() => {
    known = null;
  });
}
