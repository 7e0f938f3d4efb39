/** The 3D view beside the map, opened when it is asked for: only then is what draws it loaded. */

import { button, h } from "../../page/dom";
import { sceneApi } from "../../server/scene";
import type { Context } from "../../session/context";
import { showOutlines } from "./outlines";

export function scenePart(context: Context): void {
  const { page, mission, waiting, keys, alive } = context;
  let isOpen = false;
  const tool = button("3D view (3)", "cube", () => toggle(), {
    class: "scene-tool",
    "aria-pressed": "false",
  });
  const open = async () => {
    const [{ SceneView }, models, stops] = await Promise.all([
      import("./view"),
      sceneApi.models(mission.mission, alive),
      sceneApi.stops(mission.mission, alive),
    ]);
    if (!isOpen) return;
    if (models.length === 0) {
      close();
      waiting.say("no stop of this mission has a 3D model yet: see `[models]` of the pipeline");
      return;
    }
    const view = build(() => new SceneView(context, models, stops));
    page.beside.open("3D view", view?.element ?? withoutGraphics(), () => {
      view?.dispose();
      close();
    });
  };
  const close = () => {
    isOpen = false;
    tool.setAttribute("aria-pressed", "false");
  };
  function toggle(): void {
    if (isOpen) {
      page.beside.close();
      close();
      return;
    }
    isOpen = true;
    tool.setAttribute("aria-pressed", "true");
    waiting.run(open);
  }
  page.addTool(tool);
  keys.add("3", "3D view", toggle);
  alive.addEventListener("abort", () => page.beside.close());
  showOutlines(context);
}

/** Null where the browser draws no triangles. */
function build<T>(make: () => T): T | null {
  try {
    return make();
  } catch (reason) {
    if (reason instanceof Error && /WebGL/i.test(reason.message)) return null;
    throw reason;
  }
}

const withoutGraphics = () =>
  h(
    "p",
    { class: "hint" },
    "This browser draws no 3D graphics: WebGL 2 is switched off or missing.",
  );
