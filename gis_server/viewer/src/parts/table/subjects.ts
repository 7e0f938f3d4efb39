/** Subjects of tables: stops, images, tie points and annotations, with their columns and the source of their rows. */

import { HELD_M } from "../../page/format";
import { api, ApiError } from "../../server/api";
import { edits } from "../../server/edits";
import type { Bounds, ImageEntry, Layer, VectorLayer } from "../../server/records";
import type { Context } from "../../session/context";
import type { Table } from "../../session/state";
import { isAdjusted } from "../../map/styles";
import type { GeoJsonFeature } from "../../map/mars-geojson";
import type { Column, Row, Value } from "./rows";

export interface Subject {
  readonly key: Table["subject"];
  readonly title: string;
  /** The most important first: as many are shown as have room. */
  readonly columns: readonly Column[];
  /** Property of a feature on the map that names its row. */
  readonly named?: string;
  /** `loaded` receives the number of rows loaded so far. */
  readonly load: (context: Context, loaded: (count: number) => void) => Promise<readonly Row[]>;
}

const known = (value: unknown): Value =>
  typeof value === "number" || typeof value === "string" ? value : null;

function valuesOf(properties: Readonly<Record<string, unknown>>, keys: readonly string[]) {
  return Object.fromEntries(keys.map((key) => [key, known(properties[key])] as const));
}

function placeOf({ geometry }: GeoJsonFeature) {
  const [east_m, north_m, up_m] = (geometry?.coordinates ?? []) as readonly number[];
  return { east_m: known(east_m), north_m: known(north_m), up_m: known(up_m) };
}

const vectors = (layers: readonly Layer[]) => layers.filter((layer) => layer.type === "vector");
/** The most features that the server sends at once without a bounding box. */
const TOO_MANY = 413;
/** A layer of more features is loaded in this number of squares along each side. */
const SQUARES = 4;
/** Margin for features on the edge of their layer, whose coordinates are rounded in the file. */
const EDGE_M = 0.01;

async function* inPieces(layer: VectorLayer): AsyncGenerator<readonly GeoJsonFeature[]> {
  const query = async (bounds?: Bounds) =>
    (await api.features(layer, bounds)).features as readonly GeoJsonFeature[];
  try {
    yield await query();
    return;
  } catch (reason) {
    if (!(reason instanceof ApiError && reason.status === TOO_MANY)) throw reason;
  }
  const [west, south, east, north] = layer.bounds;
  const [width, height] = [(east - west) / SQUARES, (north - south) / SQUARES];
  for (let k = 0; k < SQUARES ** 2; k++) {
    const [w, s] = [west + (k % SQUARES) * width, south + Math.floor(k / SQUARES) * height];
    yield await query([w - EDGE_M, s - EDGE_M, w + width + EDGE_M, s + height + EDGE_M]);
  }
}

/** The rows of all features of some layers; a feature across the edge of a square is one row. */
async function rowsOf(
  layers: readonly Layer[],
  row: (feature: GeoJsonFeature) => Row | null,
  loaded: (count: number) => void,
): Promise<readonly Row[]> {
  const rows = new Map<string, Row>();
  for (const layer of vectors(layers))
    for await (const features of inPieces(layer)) {
      for (const feature of features) {
        const made = row(feature);
        if (made) rows.set(made.id, made);
      }
      loaded(rows.size);
    }
  return [...rows.values()];
}

const NORTH: Column = { key: "north_m", title: "north", unit: "m", width: 15 };
const EAST: Column = { key: "east_m", title: "east", unit: "m", width: 15 };
const UP: Column = { key: "up_m", title: "up", unit: "m", width: 15 };
const SOL: Column = { key: "sol", title: "sol", isChoice: true, width: 7 };

const STOPS: Subject = {
  key: "stops",
  title: "Stops",
  named: "stop",
  columns: [
    { key: "stop", title: "stop", width: 25 },
    SOL,
    {
      key: "moved_m",
      title: "telemetry error",
      unit: "m",
      sigma: "sigma_moved_m",
      resolution: HELD_M,
      width: 18,
    },
    { ...NORTH, sigma: "sigma_north_m", resolution: HELD_M },
    { ...EAST, sigma: "sigma_east_m", resolution: HELD_M },
    { ...UP, sigma: "sigma_down_m", resolution: HELD_M },
    { key: "site", title: "site", isChoice: true, width: 7 },
    { key: "drive", title: "drive", width: 7 },
    { key: "held_by", title: "held by", width: 36 },
  ],
  load: ({ layers }, loaded) =>
    rowsOf(
      layers.widest("stops"),
      (feature) => {
        const { properties, geometry } = feature;
        if (!isAdjusted(properties["solution"])) return null;
        const [sol] = (properties["sols"] as readonly number[] | undefined) ?? [];
        const keys = ["stop", "site", "drive", "moved_m", "held_by"];
        const sigmas = ["sigma_north_m", "sigma_east_m", "sigma_down_m"];
        const {
          sigma_north_m = null,
          sigma_east_m = null,
          ...more
        } = valuesOf(properties, [...keys, ...sigmas]);
        const sigma_moved_m = Math.hypot(Number(sigma_north_m), Number(sigma_east_m));
        const sigma = { sigma_north_m, sigma_east_m, sigma_moved_m };
        const values = { ...more, ...sigma, ...placeOf(feature), sol: known(sol) };
        return { id: String(properties["stop"]), geometry, values };
      },
      loaded,
    ),
};

const imageRow = (image: ImageEntry): Row => ({
  id: image.id,
  geometry: null,
  values: {
    image: image.id,
    ...valuesOf({ ...image }, [
      ...["sol", "stop", "instrument", "eye", "product_type", "local_solar_time"],
      ...["start_time", "partner", "unpaired_because"],
    ]),
    paired: image.partner ? "stereo pair" : "single",
  },
});

const IMAGES: Subject = {
  key: "images",
  title: "Images",
  named: "image",
  columns: [
    { key: "image", title: "image", width: 31 },
    SOL,
    { key: "stop", title: "stop", isChoice: true, width: 25 },
    { key: "instrument", title: "instrument", isChoice: true, width: 13 },
    { key: "eye", title: "eye", isChoice: true, width: 8 },
    { key: "product_type", title: "product", isChoice: true, width: 9 },
    { key: "local_solar_time", title: "local time", width: 11 },
    { key: "start_time", title: "taken, UTC", width: 24 },
    { key: "paired", title: "pair", isChoice: true, width: 12 },
    { key: "partner", title: "partner", width: 31 },
    { key: "unpaired_because", title: "without partner because", width: 40 },
  ],
  load: async ({ mission, signal }) =>
    (await api.images(mission.mission, {}, signal)).map((image) => imageRow(image)),
};

const TIES: Subject = {
  key: "ties",
  title: "Tie points",
  columns: [
    { key: "point", title: "tie point", width: 10 },
    { key: "kind", title: "kind", isChoice: true, width: 14 },
    { key: "residual_px", title: "residual", unit: "px", width: 13 },
    { key: "sigma_m", title: "position σ", unit: "m", width: 15, resolution: 0.001 },
    { key: "sols", title: "sols", isChoice: true, width: 9 },
    { ...NORTH, sigma: "sigma_m" },
    { ...EAST, sigma: "sigma_m" },
    { ...UP, sigma: "sigma_m" },
    { key: "pairs", title: "pairs", width: 40 },
  ],
  load: ({ layers }, loaded) =>
    rowsOf(
      layers.widest("tie-points"),
      (feature) => {
        const { id, properties, geometry } = feature;
        const pairs = (properties["pairs"] as readonly string[] | undefined) ?? [];
        const sols = ((properties["sols"] as readonly number[] | undefined) ?? []).join(" ");
        const values = valuesOf(properties, ["kind", "residual_px", "sigma_m"]);
        const place = placeOf(feature);
        return {
          id: String(id),
          geometry,
          values: { point: Number(id), sols, ...values, ...place, pairs: pairs.join(" ") },
        };
      },
      loaded,
    ),
};

const ANNOTATIONS: Subject = {
  key: "annotations",
  title: "Annotations",
  columns: [
    { key: "number", title: "number", width: 9 },
    { key: "text", title: "text", width: 26 },
    { key: "category", title: "category", isChoice: true, width: 14 },
    { key: "state", title: "state", isChoice: true, width: 11 },
    { key: "author", title: "author", isChoice: true, width: 14 },
    { key: "at", title: "written, UTC", width: 18 },
    { key: "shape", title: "shape", isChoice: true, width: 12 },
  ],
  load: async ({ mission }) => {
    const { features } = await edits.annotations(mission.mission);
    return features.map(({ id, geometry, properties }) => ({
      id,
      geometry,
      values: {
        number: Number(id),
        ...valuesOf({ ...properties }, ["category", "state", "text", "author", "at"]),
        shape: geometry.type,
      },
    }));
  },
};

export const SUBJECTS: readonly Subject[] = [STOPS, IMAGES, TIES, ANNOTATIONS];
