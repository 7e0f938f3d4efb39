/** Texts and legends below an image of the map. */

import { isNorthUp } from "../map/frame-ticks";
import { kindTitle } from "../map/layers";
import { legendFor, type RasterStyle } from "../map/raster-style";
import { titleOf } from "../map/title";
import { fixed, scopeTitle } from "../page/format";
import type { Layer, Legend } from "../server/records";
import type { Context } from "../session/context";
import type { SheetTexts } from "./sheet-drawing";

/** Default credit on an image of the map. */
export const CREDIT = "NASA/JPL-Caltech; map: solmap";

export function textsOf(
  { view, layers, mission, drawing, state }: Context,
  { title, credit }: { readonly title: string; readonly credit: string },
): SheetTexts {
  const { east, north, rotationDeg } = view.place;
  const [lon, lat] = view.local.toLonLat([east, north]);
  const degrees = mission.landing.origin ? "" : ` (${fixed(lat, 6)}°, ${fixed(lon, 6)}° E)`;
  const drawn = layers.shown.filter((layer) => layers.isDrawn(layer, drawing.sols));
  const names = [...new Set(drawn.map(({ kind }) => kindTitle(kind)))].join(", ");
  return {
    title,
    lines: [
      titleOf(mission, layers.all, drawing.sols).parts.join(" · "),
      `centre: north ${fixed(north, 2)} m, east ${fixed(east, 2)} m of ${mission.landing.name}${degrees}`,
      names,
      `${credit}, ${new Date().toISOString().slice(0, 10)}`,
    ],
    legends: drawn.flatMap((layer) => {
      const legend = legendOf(layer, layers.state(layer).style);
      return legend ? [[layerTitle(layer), legend] as const] : [];
    }),
    rotationDeg,
    grid: state.get("grid") && isNorthUp(rotationDeg) ? [east, north] : null,
  };
}

const layerTitle = ({ kind, scope, level }: Layer) =>
  level === "region" ? kindTitle(kind) : `${kindTitle(kind)}, ${scopeTitle(scope)}`;

function legendOf(layer: Layer, style: RasterStyle | null): Legend | null {
  return layer.type === "raster" ? legendFor(layer, style) : null;
}
