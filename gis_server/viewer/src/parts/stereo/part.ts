/** Stereo pairs beside the map: the pair of the image that was opened last, or the first there is. */

import { button } from "../../page/dom";
import type { Pane } from "../../page/panes";
import { api } from "../../server/api";
import type { Context } from "../../session/context";
import { pairOf, pairsOf } from "./fuse";

/** Of the left image in the link. */
const KEY = "stereo";

export function stereoPart({ page, mission, waiting, keys, signals, link, alive }: Context): void {
  let image: string | null = null;
  let isOpen = false;
  let pane: Pane | null = null;
  const tool = button("stereo pair (2)", "eyes", () => toggle(), {
    class: "stereo-tool",
    "aria-pressed": "false",
  });
  const close = () => {
    isOpen = false;
    pane = null;
    link.write(KEY, null);
    tool.setAttribute("aria-pressed", "false");
  };
  const open = async () => {
    const [{ StereoView }, images] = await Promise.all([
      import("./view"),
      api.images(mission.mission, {}),
    ]);
    if (!isOpen) return;
    const pairs = pairsOf(images);
    if (pairs.length === 0) {
      close();
      waiting.say("no image of this mission has a stereo partner");
      return;
    }
    const wanted = image ? pairOf(images, image)?.left.id : undefined;
    const view = new StereoView(pairs, waiting, ({ left }) => link.write(KEY, left.id));
    pane = page.panes.open("Stereo pair", view.element, () => {
      view.dispose();
      close();
    });
    view.show(pairs.find(({ left }) => left.id === wanted) ?? pairs[0]);
  };
  function toggle(): void {
    if (isOpen) {
      if (pane) pane.close();
      else close();
      return;
    }
    isOpen = true;
    tool.setAttribute("aria-pressed", "true");
    waiting.run(open);
  }
  page.addTool(tool);
  keys.add("2", "stereo pair", toggle);
  signals.image.on((id) => {
    image = id;
  });
  link.follow(KEY, (id) => {
    if (isOpen) toggle();
    if (!id) return;
    image = id;
    toggle();
  });
  alive.addEventListener("abort", () => pane?.close());
}
