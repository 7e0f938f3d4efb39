/** Legends of symbols and colours of layers. */

import { h } from "../page/dom";
import { metres, scopeTitle } from "../page/format";
import { colourLegend, legend, swatch } from "../page/legend";
import { api } from "../server/api";
import type { Layer, Legend, RasterLayer, VectorLayer } from "../server/records";
import { legendQuery } from "./bands";
import { legendFor, type RasterStyle } from "./raster-style";
import { ADJUSTED, CONTOUR, ELLIPSE_FACTORS, HAVEN, TELEMETRY, UNPAIRED, VIEWING } from "./styles";
import { NO_RESIDUAL, RESIDUALS } from "./tie-style";

const stroke = (width: number, kind: string, colour: string) =>
  `border-top:${width}px ${kind} ${colour}`;
const ways = (localised: string) =>
  legend(
    swatch(stroke(2.5, "solid", ADJUSTED), localised),
    swatch(stroke(2, "dashed", TELEMETRY), "telemetry"),
  );

function stops(factor: number, setFactor: (factor: number) => void): HTMLElement {
  const select = h(
    "select",
    { class: "ellipse-factor", onchange: () => setFactor(Number(select.value)) },
    ...ELLIPSE_FACTORS.map((one) =>
      h("option", { value: one, selected: one === factor }, `×${one}`),
    ),
  );
  return legend(
    swatch(`border:4px solid ${ADJUSTED};border-radius:50%;width:0`, "adjusted, 1σ error ellipse"),
    swatch(`border:2px solid ${ADJUSTED};border-radius:50%;width:5px;height:5px`, "held fixed"),
    swatch(`border:2px solid ${TELEMETRY};width:5px;height:5px`, "telemetry"),
    h("label", { class: "inline" }, "ellipses drawn", select),
  );
}

const ties = () =>
  legend(
    ...[...RESIDUALS, NO_RESIDUAL].map(({ colour, radius, title }) => {
      const side = `${2 * radius + 2}px`;
      return swatch(`background:${colour};border-radius:50%;width:${side};height:${side}`, title);
    }),
  );

/** Metres between contours of some elevations; null: there are fewer than two. */
export function contourInterval(elevations: Iterable<number>): number | null {
  const levels = [...new Set(elevations)].toSorted((a, b) => a - b);
  const steps = levels.slice(1).map((level, k) => level - (levels[k] ?? level));
  return steps.length > 0 ? Math.min(...steps) : null;
}

/**
 * Symbols of a layer of features; ellipses are drawn `factor` times as large, until another is chosen. Metres between
 * contours, null: not known yet.
 */
export function symbolLegend(
  { kind }: Pick<VectorLayer, "kind">,
  factor: number,
  setFactor: (factor: number) => void,
  interval: number | null,
): HTMLElement | null {
  switch (kind) {
    case "traverse":
      return ways("adjusted");
    case "mission-traverse":
    case "mission-stops":
      return ways("localised");
    case "stops":
      return stops(factor, setFactor);
    case "contours":
    case "region-contours":
    case "far-contours":
      return legend(
        swatch(stroke(2, "solid", CONTOUR), "index contour, labelled"),
        swatch(
          stroke(1, "solid", CONTOUR),
          interval === null ? "contour" : `contour every ${metres(interval)}`,
        ),
      );
    case "havens":
    case "region-havens":
      return legend(
        swatch(`border:2px solid ${HAVEN};width:12px;height:10px`, "room for a rover in winter"),
      );
    case "footprints":
    case "pointing":
      return legend(
        swatch(stroke(1.5, "solid", VIEWING), "image with stereo partner"),
        swatch(stroke(1.5, "dashed", UNPAIRED), "image without partner"),
      );
    case "tie-points":
      return ties();
    default:
      return null;
  }
}

/** Legend of classes in a layer's file, filled when they have arrived. */
function fileLegend(layer: Layer, query: string): HTMLElement {
  const list = h("div", { class: "file-legend", "data-of": layer.digest });
  const fill = ({ classes = [] }: Legend) => {
    const named = classes.map(({ name, colour }) => ({
      name: query ? scopeTitle(name) : name,
      colour,
    }));
    list.append(
      ...[colourLegend({ stops: [], unit: "", classes: named })].filter((one) => one !== null),
    );
  };
  api.legend(layer, query).then(fill, () => list.append("The legend could not be fetched."));
  return h("div", {}, list);
}

/** Of a raster in a style, null: the server's. */
export function rasterLegend(layer: RasterLayer, style: RasterStyle | null): HTMLElement | null {
  const query = legendQuery(layer);
  if (query !== null) return fileLegend(layer, query);
  const shown = legendFor(layer, style);
  return shown && colourLegend(shown);
}
