/** The panorama of a stop below the map, opened on request. */

import { button } from "../../page/dom";
import { type Panorama, panoramaApi } from "../../server/panorama";
import type { Context } from "../../session/context";

const KEY = "panorama";

export function panoramaPart(context: Context): void {
  const { page, keys, alive, waiting, mission, link, signals } = context;
  let isOpen = false;
  /** The stop of the link; null: the nearest. */
  let wanted: string | null = null;
  const tool = button("panorama (p)", "panorama", () => toggle(), {
    class: "panorama-tool",
    "aria-pressed": "false",
  });
  const close = () => {
    isOpen = false;
    wanted = null;
    tool.setAttribute("aria-pressed", "false");
    link.write(KEY, null);
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
    const remember = ({ scope }: Panorama) => link.write(KEY, scope);
    const view = new PanoramaView(context, panoramas, wanted, remember);
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
  link.follow(KEY, (scope) => {
    if (isOpen) toggle();
    wanted = scope;
    if (scope) toggle();
  });
  signals.panorama.on((scope) => {
    if (isOpen) toggle();
    wanted = scope;
    toggle();
  });
  page.addTool(tool);
  keys.add("p", "panorama of the nearest stop", toggle);
  alive.addEventListener("abort", () => isOpen && page.below.close());
}
