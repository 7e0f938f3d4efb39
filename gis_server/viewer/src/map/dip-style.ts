/**
 * The geologist's symbol of a dipping plane: a line along the strike, a tick to where the plane falls, and the dip.
 *
 * Angles are in degrees; the strike is clockwise from north, and the plane falls to its right.
 */

import type { FeatureLike } from "ol/Feature";
import LineString from "ol/geom/LineString";
import Point from "ol/geom/Point";
import Fill from "ol/style/Fill";
import Stroke from "ol/style/Stroke";
import Style from "ol/style/Style";
import Text from "ol/style/Text";

export const DIP = "#5b2a86";
const HALF_STRIKE_PX = 9;
const TICK_PX = 6;
const LABEL_PX = 13;

/** East and north of a step of `length` towards an azimuth. */
export function towards(
  azimuthDeg: number,
  length: number,
): readonly [east: number, north: number] {
  const azimuth = (azimuthDeg * Math.PI) / 180;
  return [length * Math.sin(azimuth), length * Math.cos(azimuth)];
}

export function drawDip(feature: FeatureLike, resolution: number): Style[] {
  const geometry = feature.getGeometry();
  const strike = Number(feature.get("strike_deg"));
  const dip = Number(feature.get("dip_deg"));
  if (!(geometry instanceof Point) || !Number.isFinite(strike) || !Number.isFinite(dip)) return [];
  const [east = 0, north = 0] = geometry.getCoordinates();
  const place = (azimuthDeg: number, pixels: number): [number, number] => {
    const [x, y] = towards(azimuthDeg, pixels * resolution);
    return [east + x, north + y];
  };
  const along = [place(strike, HALF_STRIKE_PX), place(strike + 180, HALF_STRIKE_PX)];
  const tick = [[east, north], place(strike + 90, TICK_PX)];
  const text = new Text({
    text: dip.toFixed(0),
    font: "11px system-ui, sans-serif",
    fill: new Fill({ color: DIP }),
    stroke: new Stroke({ color: "rgba(255,255,255,0.75)", width: 3 }),
  });
  return [
    ...[along, tick].map(
      (ends) =>
        new Style({
          geometry: new LineString(ends),
          stroke: new Stroke({ color: DIP, width: 2 }),
        }),
    ),
    new Style({ geometry: new Point(place(strike + 90, LABEL_PX)), text }),
  ];
}
