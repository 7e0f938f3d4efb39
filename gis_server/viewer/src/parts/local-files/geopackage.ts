/** Tables of features in a GeoPackage (OGC 12-128), read by SQLite in the browser. */

import GeoJSON from "ol/format/GeoJSON";
import WKB from "ol/format/WKB";
import initSqlJs from "sql.js";
import wasm from "sql.js/dist/sql-wasm-browser.wasm?url";
import type { GeoJsonFeature, GeoJsonGeometry } from "../../map/mars-geojson";
import { RefusedFile } from "./crs";

export interface FeatureTable {
  readonly name: string;
  readonly features: readonly GeoJsonFeature[];
  /** WKT of its coordinate system; null where that is undefined. */
  readonly definition: string | null;
}

const TABLES = `
  SELECT g.table_name, g.column_name, s.definition FROM gpkg_geometry_columns g
  LEFT JOIN gpkg_spatial_ref_sys s ON s.srs_id = g.srs_id`;
/** Bytes of the bounds in the header of a geometry, by the code in its flags. */
const ENVELOPES = [0, 32, 48, 48, 64];
const HEADER = 8;
const EMPTY = 0b10000;

const quoted = (name: string) => `"${name.replaceAll('"', '""')}"`;

export async function geopackage(bytes: Uint8Array): Promise<readonly FeatureTable[]> {
  const sql = await initSqlJs({ locateFile: () => wasm });
  const database = new sql.Database(bytes);
  try {
    const [tables] = database.exec(TABLES);
    if (!tables) throw new RefusedFile("the GeoPackage holds no table of features");
    return tables.values.map(([table, column, definition]) => {
      const name = String(table);
      const [found] = database.exec(`SELECT * FROM ${quoted(name)}`);
      const at = found?.columns.indexOf(String(column)) ?? -1;
      const features = (found?.values ?? []).map((values): GeoJsonFeature => {
        const named = values.map((value, k) => [found?.columns[k] ?? "", value] as const);
        const properties = Object.fromEntries(named.filter((_, k) => k !== at));
        return { type: "Feature", geometry: geometryOf(values[at]), properties };
      });
      const isKnown = typeof definition === "string" && definition !== "undefined";
      return { name, features, definition: isKnown ? definition : null };
    });
  } catch (reason) {
    if (reason instanceof RefusedFile) throw reason;
    throw new RefusedFile(`it is not a GeoPackage: ${(reason as Error).message}`);
  } finally {
    database.close();
  }
}

function geometryOf(blob: unknown): GeoJsonGeometry | null {
  if (!(blob instanceof Uint8Array) || blob.length <= HEADER) return null;
  const flags = blob[3] ?? 0;
  if (flags & EMPTY) return null;
  const wkb = blob.slice(HEADER + (ENVELOPES[(flags >> 1) & 7] ?? 0));
  const geometry = new WKB().readGeometry(wkb);
  return geometry && (new GeoJSON().writeGeometryObject(geometry) as GeoJsonGeometry);
}
