/** Tie points in space. */

import { api } from "../../server/api";
import type { VectorLayer } from "../../server/records";
import type { Place3 } from "../../server/scene";
import type { LayerList } from "../../session/layer-list";

export async function tiePlaces(layers: LayerList): Promise<readonly Place3[]> {
  const drawn = layers.widest("tie-points") as readonly VectorLayer[];
  const all = await Promise.all(drawn.map((layer) => api.features(layer)));
  return all.flatMap(({ features }) => features.map(placeOf));
}

function placeOf(feature: unknown): Place3 {
  const { geometry } = feature as {
    readonly geometry: { readonly coordinates: readonly number[] };
  };
  const [east = 0, north = 0, up = 0] = geometry.coordinates;
  return [east, north, up];
}
