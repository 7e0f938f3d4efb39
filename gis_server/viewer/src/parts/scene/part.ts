/** The 3D view beside the map, opened on request; only then is its code loaded. */

import { button, h } from "../../page/dom";
import type { Pane } from "../../page/panes";
import { sceneApi } from "../../server/scene";
import type { MapPoint } from "../../server/records";
import type { Context } from "../../session/context";
import {
  formatViewpoint,
  formatShown,
  type Viewpoint,
  parseViewpoint,
  parseShown,
  type Shown,
} from "./viewpoint";
import { showOutlines } from "./outlines";
import type { SceneView } from "./view";

const KEY = "view3d";
const SHOWN_KEY = "show3d";

export function scenePart(context: Context): void {
  const { page, mission, waiting, keys, places, frames, link, alive } = context;
  let isOpen = false;
  let shown: SceneView | null = null;
  let pane: Pane | null = null;
  let wanted: MapPoint | null = null;
  /** Eye and what is looked at in the link. */
  let linked: Viewpoint | null = null;
  const tool = button("3D view (3)", "cube", () => toggle(), {
    class: "scene-tool",
    "aria-pressed": "false",
  });
  const open = async () => {
    const [{ SceneView: View }, models, stops] = await Promise.all([
      import("./view"),
      sceneApi.models(mission.mission, alive),
      frames.load(),
    ]);
    if (!isOpen) return;
    if (models.length === 0) {
      close();
      waiting.say("no stop of this mission has a 3D model yet: see `[models]` of the pipeline");
      return;
    }
    const callbacks = {
      viewpoint: (to: Viewpoint) => link.write(KEY, formatViewpoint(to)),
      shown: (to: Shown) => link.write(SHOWN_KEY, formatShown(to)),
    };
    const begin = { viewpoint: linked, shown: parseShown(link.read(SHOWN_KEY)) };
    const view = build(() => new View(context, models, stops, begin, callbacks));
    pane = page.panes.open("3D view", view?.element ?? withoutGraphics(), () => {
      view?.dispose();
      close();
    });
    shown = view;
    if (wanted) view?.visit(wanted);
  };
  const close = () => {
    isOpen = false;
    [shown, wanted, linked, pane] = [null, null, null, null];
    link.write(KEY, null);
    link.write(SHOWN_KEY, null);
    tool.setAttribute("aria-pressed", "false");
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
  const visit = (point: MapPoint) => {
    wanted = point;
    if (shown) shown.visit(point);
    else if (!isOpen) toggle();
  };
  link.follow(KEY, (text) => {
    const viewpoint = parseViewpoint(text);
    if (viewpoint && shown) {
      shown.look(viewpoint);
      return;
    }
    if (isOpen) toggle();
    linked = viewpoint;
    if (viewpoint) toggle();
  });
  link.onRestored(SHOWN_KEY, () => shown?.show(parseShown(link.read(SHOWN_KEY))));
  page.addTool(tool);
  places.add({ title: "3D here", run: visit });
  keys.add("3", "3D view", toggle);
  alive.addEventListener("abort", () => pane?.close());
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
