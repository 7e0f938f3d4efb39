/** Records for tests: one site at Gusev, as the server describes it. */

import type { Mission, RasterLayer, VectorLayer } from "./server/records";

export const PROJ4 = "+proj=ortho +lat_0=-14.5692 +lon_0=175.4729 +R=3396190 +units=m +no_defs";
const HALF_SIDE_M = 0.01 * 256 * 2 ** 19;

export const MISSION: Mission = {
  mission: "MER2",
  title: "Spirit, Gusev crater",
  landing: {
    origin: "",
    name: "Columbia Memorial Station",
    longitude: 175.4729,
    latitude: -14.5692,
    radius_m: 3396190,
    source: "a test",
  },
  crs: { wkt: "", proj4: PROJ4 },
  lsl_note: null,
  tile_matrix_set: {
    extent: [-HALF_SIDE_M, -HALF_SIDE_M, HALF_SIDE_M, HALF_SIDE_M],
    cell_sizes: Array.from({ length: 21 }, (_, zoom) => 0.01 * 2 ** (20 - zoom)),
    tile_size: 256,
  },
  bounds: [-40, -40, 40, 40],
};

const FACTS = {
  digest: "0123456789abcdef",
  title: "",
  bounds: [-40, -40, 40, 40],
  unit: null,
  range: null,
  sols: [155],
  made_at: "2026-11-21T01:02:03+00:00",
  legend: null,
  download: "/download/a",
  provenance: "/api/layers/a/provenance",
} as const;

const levelOf = (scope: string) =>
  scope.includes("site") ? "stop" : scope.includes("sol") ? "sol" : "region";

export function rasterLayer(scope: string, kind: string): RasterLayer {
  return {
    ...FACTS,
    id: `${scope}/${kind}`,
    scope,
    level: levelOf(scope),
    kind,
    cell_m: 0.08,
    minzoom: 12,
    maxzoom: 17,
    type: "raster",
    tiles: `/tiles/${scope}/${kind}/${FACTS.digest}/{z}/{x}/{y}.webp`,
    values: `/tiles/${scope}/${kind}/${FACTS.digest}/{z}/{x}/{y}.values`,
  };
}

export function vectorLayer(scope: string, kind: string): VectorLayer {
  return {
    ...FACTS,
    id: `${scope}/${kind}`,
    scope,
    level: levelOf(scope),
    kind,
    cell_m: null,
    minzoom: null,
    maxzoom: null,
    type: "vector",
    features: `/api/layers/${scope}/${kind}/${FACTS.digest}/features.geojson`,
  };
}
