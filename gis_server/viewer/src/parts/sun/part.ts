/** The sun over the map: by sol and solar time or set manually, with its layers. The link keeps it. */

import { kindTitle } from "../../map/layers";
import { hasValues, isElevation } from "../../map/raster-style";
import { CARTOGRAPHERS_SUN, type SunPlace } from "../../map/shading";
import { h } from "../../page/dom";
import { scopeTitle } from "../../page/format";
import { api } from "../../server/api";
import type { RasterLayer } from "../../server/records";
import type { Context } from "../../session/context";
import { formatLight, formatSky, type Light, parseLight, parseSky, type Sky } from "./light";
import { solsBegin } from "./mars-time";
import { Overlays } from "./overlays";
import { type SunPanel, sunPanel } from "./panel";
import "./sun.css";
import { type Daylight, daylight } from "./sun-place";

const [SUN, LIVE, GROUND] = ["sun", "live", "ground"] as const;

export function sunPart(context: Context): void {
  const { page, layers, link, sun, mission, waiting, signals, alive } = context;
  const tab = page.addTab("sun", "Sun");
  const overlays = new Overlays(context);
  let sky: Sky = parseSky(link.read(SUN)) ?? { by: "hand", sun: sun.value };
  let light = parseLight(link.read(LIVE));
  let begin: number | null = null;
  let panel: SunPanel | null = null;

  const daily = (): Daylight | null =>
    sky.by === "time" && begin !== null
      ? daylight(mission.landing, begin, sky.sol, sky.hours)
      : null;
  const place = (): SunPlace => (sky.by === "hand" ? sky.sun : (daily()?.sun ?? sun.value));
  const show = () => overlays.show(groundOf(context), light, sun.value);
  const follow = () => panel?.follow({ sky, sun: sun.value, day: daily(), light });
  let frame = 0;
  const shine = () => {
    cancelAnimationFrame(frame); // a slider sends more events than the map draws frames
    frame = requestAnimationFrame(() => sun.set(place()));
  };
  const setSky = (next: Sky) => {
    sky = next;
    link.write(SUN, formatSky(sky));
    shine();
  };
  const setLight = (next: Light) => {
    light = next;
    link.write(LIVE, formatLight(light));
    follow();
    show();
  };
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
    const setGround = (id: string) => {
      link.write(GROUND, id);
      draw();
    };
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

  const restore = () => {
    sky = parseSky(link.read(SUN)) ?? { by: "hand", sun: CARTOGRAPHERS_SUN };
    light = parseLight(link.read(LIVE));
    draw();
    sun.set(place());
  };
  for (const key of [SUN, LIVE, GROUND]) link.onRestored(key, restore);
  sun.changed.on(() => {
    follow();
    show();
  });
  layers.replaced.on(draw);
  layers.rearranged.on(show);
  layers.changed.on(show);
  signals.sols.on((sols) => {
    if (sols !== null && sky.by === "time") setSky({ ...sky, sol: sols[1] });
  });
  alive.addEventListener("abort", () => overlays.clear());
  draw();
  waiting.run(load);
}

/** The shaded terrain model: the chosen one, or the widest. */
function groundOf({ layers, link }: Context): RasterLayer | null {
  const chosen = layers.all.find(({ id }) => id === link.read(GROUND));
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
