/** The panorama of a stop below the map, opened when it is asked for. */

import { button } from "../../page/dom";
import { panoramaApi } from "../../server/panorama";
import type { Context } from "../../session/context";

export function panoramaPart(context: Context): void {
  const { page, keys, alive, waiting, mission } = context;
  let isOpen = false;
  const tool = button("panorama (p)", "panorama", () => toggle(), {
    class: "panorama-tool",
    "aria-pressed": "false",
  });
  const close = () => {
    isOpen = false;
    tool.setAttribute("aria-pressed", "false");
  };
  const open = async () => {
    const [{ PanoramaView }, panoramas] = await Promise.all([
      import("./view"),
      panoramaApi.all(mission.mission, alive),
    ]);
    if (!isOpen) return;
    if (panoramas.length === 0) {
      close();
      waiting.say("no stop of this mission has a panorama yet: see `[panoramas]` of the pipeline");
      return;
    }
    const view = new PanoramaView(context, panoramas);
    page.below.open("Panorama", view.element, () => {
      view.dispose();
      close();
    });
  };
  function toggle(): void {
    if (isOpen) {
      page.below.close();
      close();
      return;
    }
    isOpen = true;
    tool.setAttribute("aria-pressed", "true");
    waiting.run(open);
  }
  page.addTool(tool);
  keys.add("p", "panorama of the nearest stop", toggle);
  alive.addEventListener("abort", () => isOpen && page.below.close());
}
