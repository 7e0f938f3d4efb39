/** The drawn shape, as GeoJSON in metres of the map. */

import type { Shape } from "../../map/sketch";
import type { AnnotationEdit } from "../../server/edits";
import type { MapPoint } from "../../server/records";

const MM = 1000;
const rounded = ([east, north]: MapPoint) => [
  Math.round(east * MM) / MM,
  Math.round(north * MM) / MM,
];

/** The shape that a geometry was drawn as. */
export function shapeOf({ type }: AnnotationEdit["geometry"]): Shape {
  if (type === "Point") return "point";
  return type === "LineString" ? "line" : "area";
}

/** Areas are closed here: sketches leave their last corner out. */
export function geometryOf(shape: Shape, corners: readonly MapPoint[]): AnnotationEdit["geometry"] {
  const places = corners.map(rounded);
  const [first = []] = places;
  switch (shape) {
    case "point":
      return { type: "Point", coordinates: first };
    case "line":
      return { type: "LineString", coordinates: places };
    default:
      return { type: "Polygon", coordinates: [[...places, first]] };
  }
}
