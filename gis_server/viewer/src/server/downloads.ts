/** Files for download: models, parts of layers, features of the whole mission, and addresses for other programs. */

import { get, of } from "./api";
import type { Bounds, Layer } from "./records";

/** Something to copy into another program. */
export interface Address {
  readonly title: string;
  readonly service: string;
  readonly url: string;
  readonly program: string;
  readonly how: string;
}

export interface ModelFile {
  readonly id: string;
  readonly scope: string;
  readonly kind: string;
  readonly title: string;
  readonly download: string;
}

/** Features of the whole mission, in several formats. */
export interface Collection {
  readonly id: string;
  readonly title: string;
  readonly items: string;
}

interface Collections {
  readonly collections: readonly {
    readonly id: string;
    readonly title?: string;
    readonly links: readonly { readonly rel: string; readonly href: string }[];
  }[];
}

export const FEATURE_FORMATS = [
  ["gpkg", "GeoPackage"],
  ["fgb", "FlatGeobuf"],
  ["geojson", "GeoJSON"],
  ["csv", "CSV"],
] as const;

const COORDINATE_DECIMALS = 3;

/** The terrain model of a stop as a solid that can be printed. */
export const stlUrl = ({ scope, digest }: Layer) =>
  `models/${encodeURIComponent(scope)}/dtm/${digest}/terrain.stl`;

/** The part of a layer in a box, as its cells or features are stored. */
export function clipUrl(layer: Layer, box: Bounds, form: "geojson" | "gpkg" = "geojson"): string {
  const bbox = box.map((metres) => Number(metres.toFixed(COORDINATE_DECIMALS))).join(",");
  const query = layer.type === "vector" ? `bbox=${bbox}&f=${form}` : `bbox=${bbox}`;
  return `${layer.download}/clip?${query}`;
}

export const downloads = {
  addresses: (mission: string) => get<readonly Address[]>(`${of(mission)}/addresses`),
  models: (mission: string) => get<readonly ModelFile[]>(`${of(mission)}/models`),
  collections: async (mission: string): Promise<readonly Collection[]> => {
    const root = `ogc/${encodeURIComponent(mission)}/collections`;
    const { collections } = await get<Collections>(root);
    const ofFeatures = collections.filter(({ links }) => links.some(({ rel }) => rel === "items"));
    return ofFeatures.map(({ id, title }) => ({
      id,
      title: title ?? id,
      items: `${root}/${encodeURIComponent(id)}/items`,
    }));
  },
};
