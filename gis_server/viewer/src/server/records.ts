/** Records of the server: missions, layers, images, and the values at a point. Field names are the server's. */

/** Metres in the mission's local map. */
export type Bounds = readonly [west: number, south: number, east: number, north: number];
/** Metres in the mission's local map: along LSL y, along LSL x. */
export type MapPoint = readonly [east: number, north: number];
/** Degrees, planetocentric, longitude positive east. */
export type LonLat = readonly [lon: number, lat: number];

export interface TileMatrixSet {
  readonly extent: Bounds;
  /** Metres a cell at every zoom, coarsest first. */
  readonly cell_sizes: readonly number[];
  readonly tile_size: number;
}

export interface Mission {
  readonly mission: string;
  readonly title: string;
  readonly landing: {
    readonly name: string;
    /** Origin of a map that is not tied to the lander; else empty. */
    readonly origin: string;
    readonly longitude: number;
    readonly latitude: number;
    readonly radius_m: number;
    readonly source: string;
  };
  /** No PROJ string of a map that is not tied to the lander: it has no longitude and latitude. */
  readonly crs: { readonly wkt: string; readonly proj4: string | null };
  readonly lsl_note: string | null;
  readonly tile_matrix_set: TileMatrixSet;
  readonly bounds: Bounds;
}

export type Level = "stop" | "sol" | "region";

export interface Legend {
  readonly stops: readonly (readonly [value: number, colour: string])[];
  readonly unit: string | null;
  /** Names of classes, for a layer of classes; else empty. */
  readonly classes?: readonly { readonly name: string; readonly colour: string }[];
  /** Further properties that a reader needs. */
  readonly note?: string;
}

interface LayerFacts {
  /** Scope and kind: unchanged when the product is made again. */
  readonly id: string;
  readonly scope: string;
  readonly level: Level;
  readonly kind: string;
  readonly digest: string;
  readonly title: string;
  readonly bounds: Bounds;
  readonly cell_m: number | null;
  readonly minzoom: number | null;
  readonly maxzoom: number | null;
  readonly unit: string | null;
  readonly range: readonly [least: number, most: number] | null;
  readonly sols: readonly number[];
  readonly made_at: string;
  readonly legend: Legend | null;
  readonly download: string;
  readonly provenance: string;
  /** Description of an earlier version that was added; the latest has none. */
  readonly version?: string;
}

export interface RasterLayer extends LayerFacts {
  readonly type: "raster";
  readonly tiles: string;
  /** Tiles of values; null for images and classes. */
  readonly values: string | null;
}

export interface VectorLayer extends LayerFacts {
  readonly type: "vector";
  readonly features: string;
}

/** Distinguished by `type`. */
export type Layer = RasterLayer | VectorLayer;

/** Data of the first view of the map. */
export interface Start {
  readonly missions: readonly Mission[];
  /** The mission whose layers these are; null if the store holds none. */
  readonly mission: string | null;
  readonly layers: readonly Layer[];
  /** The number of the last event included here; null if the server does not give it. */
  readonly lastEvent: string | null;
}

export interface ImageEntry {
  readonly id: string;
  readonly stop: string;
  readonly site: number;
  readonly drive: number;
  readonly sol: number;
  readonly instrument: string;
  readonly eye: string;
  readonly product_type: string;
  readonly local_solar_time: string | null;
  readonly start_time: string | null;
  readonly partner: string | null;
  readonly unpaired_because: string | null;
  readonly browse: string | null;
  readonly original: string | null;
}

export interface IdentifiedLayer {
  readonly id: string;
  readonly kind: string;
  readonly scope: string;
  readonly value: number | null;
  readonly sigma: number | null;
  readonly cell_m: number | null;
  /** The meaning of the value, where it is a class. */
  readonly label: string | null;
  readonly unit: string | null;
  readonly title: string;
}

export interface Identified {
  readonly east: number;
  readonly north: number;
  /** Absent on a map that is not tied to the lander. */
  readonly lon: number | null;
  readonly lat: number | null;
  readonly elevation_m: number | null;
  readonly elevation_sigma_m: number | null;
  readonly layers: readonly IdentifiedLayer[];
  readonly features: readonly Readonly<Record<string, unknown>>[];
}

/** Properties of a feature wherever the server put them: in GeoJSON's place, or flat. */
export function propertiesOf(feature: Readonly<Record<string, unknown>>): Record<string, unknown> {
  const { properties, ...flat } = feature;
  return typeof properties === "object" && properties !== null
    ? { ...flat, ...(properties as Record<string, unknown>) }
    : flat;
}

/** Ids of the images whose footprint contains the point, each once; pointing lines do not count. */
export function imagesAt({ features }: Identified): string[] {
  const ids = features
    .filter(({ kind }) => kind === "footprints")
    .map((feature) => propertiesOf(feature)["image"]);
  return [...new Set(ids.filter((id): id is string => typeof id === "string"))];
}
