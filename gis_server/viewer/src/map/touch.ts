/**
 * Features under the pointer, found by geometry: redrawing ten thousand footprints to read one pixel takes too long.
 */

import type Feature from "ol/Feature";
import type Geometry from "ol/geom/Geometry";
import type VectorSource from "ol/source/Vector";

/** The feature nearest to a place, within a distance; `isDrawn` leaves out features that are not on the screen. */
export function nearest(
  source: VectorSource<Feature<Geometry>>,
  [x = 0, y = 0]: readonly number[],
  within: number,
  isDrawn: (feature: Feature<Geometry>) => boolean,
): Feature<Geometry> | null {
  let best: Feature<Geometry> | null = null;
  let least = within;
  source.forEachFeatureInExtent([x - within, y - within, x + within, y + within], (feature) => {
    const outline = feature.getGeometry();
    if (!outline) return;
    const [nearX = 0, nearY = 0] = outline.getClosestPoint([x, y]);
    const distance = Math.hypot(nearX - x, nearY - y);
    if (distance > least || !isDrawn(feature)) return;
    least = distance;
    best = feature;
  });
  return best;
}
