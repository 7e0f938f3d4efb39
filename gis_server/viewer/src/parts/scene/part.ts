/** The 3D view beside the map, opened on request; only then is its code loaded. */

import { h } from "../../page/dom";
import { sceneApi } from "../../server/scene";
import type { MapPoint } from "../../server/records";
import type { Context } from "../../session/context";
import { addPane } from "../../session/pane";
import { type Viewpoint, NOTHING_SHOWN } from "../../session/state";
import { showOutlines } from "./outlines";
import type { SceneView } from "./view";

export function scenePart(context: Context): void {
  const { mission, waiting, places, frames, state, signal } = context;
  let shown: SceneView | null = null;
  let requested: MapPoint | null = null;
  const writeShown = state.follow("show3d", (now) => shown?.show(now));
  addPane(context, "view3d", {
    title: "3D view",
    side: "beside",
    tool: {
      name: "3D view",
      picture: "cube",
      key: "3",
      does: "3D view",
      class: "scene-tool",
      first: () => ({ look: null }),
    },
    load: async (write) => {
      const [{ SceneView: View }, models, stops] = await Promise.all([
        import("./view"),
        sceneApi.models(mission.mission, signal),
        frames.load(),
      ]);
      const look = state.get("view3d")?.look ?? null;
      if (models.length === 0) {
        waiting.notify(
          "no stop of this mission has a 3D model yet: see `[models]` of the pipeline",
        );
        return null;
      }
      const callbacks = { viewpoint: (now: Viewpoint) => write({ look: now }), shown: writeShown };
      const begin = { viewpoint: look, shown: state.get("show3d") };
      const view = build(() => new View(context, models, stops, begin, callbacks));
      shown = view;
      if (requested) view?.visit(requested);
      return {
        element: view?.element ?? withoutGraphics(),
        show: ({ look: now }) => {
          if (now && now !== look) view?.look(now);
        },
        dispose: () => {
          view?.dispose();
          [shown, requested] = [null, null];
          writeShown(NOTHING_SHOWN);
        },
      };
    },
  });
  const visit = (point: MapPoint) => {
    requested = point;
    if (shown) shown.visit(point);
    else if (state.get("view3d") === null) state.set("view3d", { look: null });
  };
  places.add({ title: "3D here", run: visit });
  showOutlines(context);
}

/** The result of `make`; null if the browser draws no triangles. */
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
