/** Difference vectors on the map: from a stop's position in one solution to that in the other. */

import Feature from "ol/Feature";
import type Geometry from "ol/geom/Geometry";
import LineString from "ol/geom/LineString";
import OlVectorLayer from "ol/layer/Vector";
import type OlMap from "ol/Map";
import VectorSource from "ol/source/Vector";
import Fill from "ol/style/Fill";
import Stroke from "ol/style/Stroke";
import Style from "ol/style/Style";
import Text from "ol/style/Text";
import { metres } from "../../page/format";
import type { TraverseAnswer, TraverseRow } from "../../server/network";
import type { MapPoint } from "../../server/records";

export const VECTOR = "#8a4fff";
const CASING = "rgba(255,255,255,0.85)";
const HEAD_PX = 9;
const Z_INDEX = 990;
export const FACTORS = [1, 2, 5, 10, 20, 50, 100, 200, 500, 1000] as const;

/** The largest factor that keeps the longest vector within a fifth of the traverse. */
export function vectorFactor({ rows }: TraverseAnswer): number {
  const longest = Math.max(0, ...rows.map(({ horizontal_m }) => horizontal_m));
  const way = rows.at(-1)?.distance_m ?? 0;
  if (!(longest > 0)) return 1;
  return FACTORS.findLast((factor) => factor * longest <= way / 5) ?? 1;
}

/** Both ends of a stop's vector, drawn `factor` times as long. */
export function vectorEnds(row: TraverseRow, factor: number): readonly [MapPoint, MapPoint] {
  const [east, north] = row.place;
  return [
    [east, north],
    [east + factor * row.offset_m[0], north + factor * row.offset_m[1]],
  ];
}

/** Corners of an arrow head at the end of a vector, in metres. */
export function headOf(
  [[e0, n0], [e1, n1]]: readonly [MapPoint, MapPoint],
  size_m: number,
): MapPoint[] {
  const length = Math.hypot(e1 - e0, n1 - n0) || 1;
  const [ue, un] = [(e1 - e0) / length, (n1 - n0) / length];
  const back = Math.min(size_m, length);
  const side = (sign: number): MapPoint => [
    e1 - back * ue - 0.45 * sign * back * un,
    n1 - back * un + 0.45 * sign * back * ue,
  ];
  return [side(1), [e1, n1], side(-1)];
}

export class DifferenceVectors {
  private readonly source = new VectorSource<Feature<Geometry>>();
  private readonly layer = new OlVectorLayer({
    source: this.source,
    zIndex: Z_INDEX,
    style: (feature, resolution) => draw(feature as Feature<Geometry>, resolution),
  });

  constructor(private readonly map: OlMap) {
    map.addLayer(this.layer);
  }

  /** Shows the vectors of an answer; null shows none. */
  show(answer: TraverseAnswer | null, factor: number): void {
    this.source.clear();
    for (const row of answer?.rows ?? []) {
      if (!(row.horizontal_m > 0)) continue;
      const ends = vectorEnds(row, factor);
      const feature = new Feature<Geometry>(new LineString(ends.map((point) => [...point])));
      feature.setProperties({ ends, label: metres(row.horizontal_m) });
      this.source.addFeature(feature);
    }
  }

  dispose(): void {
    this.map.removeLayer(this.layer);
  }
}

function draw(feature: Feature<Geometry>, resolution: number): Style[] {
  const ends = feature.get("ends") as readonly [MapPoint, MapPoint];
  const head = new LineString(headOf(ends, HEAD_PX * resolution).map((point) => [...point]));
  const text = new Text({
    text: String(feature.get("label")),
    font: "600 11px system-ui, sans-serif",
    fill: new Fill({ color: "#4a1fb8" }),
    stroke: new Stroke({ color: CASING, width: 3 }),
    offsetY: -10,
    overflow: true,
  });
  return [
    new Style({ stroke: new Stroke({ color: CASING, width: 5 }) }),
    new Style({ stroke: new Stroke({ color: CASING, width: 5 }), geometry: head }),
    new Style({ stroke: new Stroke({ color: VECTOR, width: 2.5 }), text }),
    new Style({ stroke: new Stroke({ color: VECTOR, width: 2.5 }), geometry: head }),
  ];
}
