/** Types of the used parts of libraries without types. */

declare module "shpjs" {
  import type { GeoJsonFeature } from "../../map/mars-geojson";
  interface Parts {
    readonly shp: Uint8Array | undefined;
    readonly dbf?: Uint8Array;
    readonly cpg?: string;
  }
  export default function shp(
    parts: Parts,
  ): Promise<{ readonly features: readonly GeoJsonFeature[] }>;
}

declare module "sql.js" {
  type Value = number | string | Uint8Array | null;
  interface Rows {
    readonly columns: readonly string[];
    readonly values: readonly (readonly Value[])[];
  }
  interface Database {
    exec(query: string): readonly Rows[];
    close(): void;
  }
  interface Sql {
    readonly Database: new (bytes: Uint8Array) => Database;
  }
  export default function initSqlJs(options: { locateFile: () => string }): Promise<Sql>;
}
