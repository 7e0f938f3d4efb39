/** The sun over the map: by sol and solar time or set manually, with its layers. The link keeps it. */

import { kindTitle } from "../../map/layers";
import { hasValues, isElevation } from "../../map/raster-style";
import { CARTOGRAPHERS_SUN, type SunPlace } from "../../map/shading";
import { h } from "../../page/dom";
import { scopeTitle } from "../../page/format";
import { api } from "../../server/api";
import type { RasterLayer } from "../../server/records";
import type { Context } from "../../session/context";
import type { Light, Sky } from "../../session/state";
import { solsBegin } from "./mars-time";
import { Overlays } from "./overlays";
import { type SunPanel, sunPanel } from "./panel";
import "./sun.css";
import { type Daylight, daylight } from "./sun-place";

export function sunPart(context: Context): void {
  const { page, layers, state, sun, mission, waiting, signal } = context;
  const tab = page.addTab("sun");
  const overlays = new Overlays(context);
  const sky = (): Sky => state.get("sun") ?? { by: "hand", sun: CARTOGRAPHERS_SUN };
  let begin: number | null = null;
  let panel: SunPanel | null = null;

  const daily = (): Daylight | null => {
    const now = sky();
    if (now.by === "hand" || begin === null) return null;
    return daylight(mission.landing, begin, now.sol, now.hours);
  };
  const place = (): SunPlace => {
    const now = sky();
    return now.by === "hand" ? now.sun : (daily()?.sun ?? sun.value);
  };
  const show = () => overlays.show(groundOf(context), state.get("live"), sun.value);
  const follow = () =>
    panel?.follow({ sky: sky(), sun: sun.value, day: daily(), light: state.get("live") });
  let frame = 0;
  const shine = () => {
    cancelAnimationFrame(frame); // a slider sends more events than the map draws frames
    frame = requestAnimationFrame(() => sun.set(place()));
  };
  const setSky = (next: Sky) => state.set("sun", next);
  const setLight = (next: Light) => state.set("live", next);
  const draw = () => {
    const ground = groundOf(context);
    const known = layers.all.filter((layer) => isElevation(layer) && hasValues(layer));
    if (!ground) {
      tab.replaceChildren(h("p", { class: "hint" }, "There is no terrain model to shine on yet."));
      return;
    }
    const titles = known.map(
      ({ id, kind, scope }) => [id, `${kindTitle(kind)} · ${scopeTitle(scope)}`] as const,
    );
    const setGround = (id: string) => state.set("ground", id);
    const firstSol = begin === null ? null : (layers.all.flatMap(({ sols }) => [...sols])[0] ?? 0);
    panel = sunPanel(titles, ground, firstSol, { setSky, setLight, setGround });
    tab.replaceChildren(panel.element);
    follow();
    show();
  };
  const load = async () => {
    begin = await beginOf(context);
    draw();
    sun.set(place());
  };

  state.on("sun", shine);
  state.on("ground", draw);
  state.on("live", () => {
    follow();
    show();
  });
  sun.changed.on(() => {
    follow();
    show();
  });
  layers.replaced.on(draw);
  layers.rearranged.on(show);
  layers.changed.on(show);
  state.on("sol", (sols) => {
    const now = sky();
    if (sols !== null && now.by === "time") setSky({ ...now, sol: sols[1] });
  });
  signal.addEventListener("abort", () => overlays.clear());
  draw();
  waiting.run(load);
}

/** The terrain model that is shone on: the chosen one, or the widest. */
function groundOf({ layers, state }: Context): RasterLayer | null {
  const chosen = layers.all.find(({ id }) => id === state.get("ground"));
  const widest = [...layers.widest("region-dtm"), ...layers.widest("dtm")];
  return [...(chosen ? [chosen] : []), ...widest].find(hasValues) ?? null;
}

/** How sols are counted, from the images of one sol; from all if those have no times. */
async function beginOf({ mission, layers }: Context): Promise<number | null> {
  const { longitude } = mission.landing;
  const sol = layers.all.flatMap(({ sols }) => [...sols])[0];
  const some = sol === undefined ? [] : await api.images(mission.mission, { sol });
  return solsBegin(some, longitude) ?? solsBegin(await api.images(mission.mission, {}), longitude);
}
