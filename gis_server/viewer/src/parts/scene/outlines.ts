/** The rover's outline at every stop, to scale, where the map is large enough to show it. */

import Feature from "ol/Feature";
import Polygon from "ol/geom/Polygon";
import OlVectorLayer from "ol/layer/Vector";
import VectorSource from "ol/source/Vector";
import Fill from "ol/style/Fill";
import Stroke from "ol/style/Stroke";
import Style from "ol/style/Style";
import { sceneApi } from "../../server/scene";
import type { Context } from "../../session/context";
import { outline } from "./geometry";

/** A rover is 30 pixels wide then. */
const MOST_M_PER_PX = 0.08;
const STYLE = new Style({
  stroke: new Stroke({ color: "#1c2f57", width: 1.5 }),
  fill: new Fill({ color: "rgba(44,62,102,0.15)" }),
});

export function showOutlines({ view, mission, waiting, layers, signal }: Context): void {
  const source = new VectorSource<Feature<Polygon>>();
  const layer = new OlVectorLayer({
    source,
    style: STYLE,
    zIndex: 999,
    maxResolution: MOST_M_PER_PX,
  });
  view.map.addLayer(layer);
  let isRequested = false;
  const load = async () => {
    const { stops, body } = await sceneApi.stops(mission.mission, signal);
    source.clear();
    if (!body) return;
    const figures = stops.map((stop) => new Polygon([outline(stop, body).map((at) => [...at])]));
    source.addFeatures(figures.map((figure) => new Feature(figure)));
  };
  const update = () => {
    if (isRequested || view.resolution > MOST_M_PER_PX) return;
    isRequested = true;
    waiting.run(load);
  };
  view.view.on("change:resolution", update);
  layers.replaced.on(() => {
    isRequested = false;
    update();
  });
  update();
}
