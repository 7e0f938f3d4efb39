/** Shapefiles in a zip archive. */

import { strFromU8, unzipSync } from "fflate";
import shp from "shpjs";
import type { GeoJsonFeature } from "../../map/mars-geojson";
import { RefusedFile } from "./crs";

export interface Shapefile {
  readonly name: string;
  /** Features in coordinates of the file. */
  readonly features: readonly GeoJsonFeature[];
  /** WKT of its coordinate system; null if there is no `.prj`. */
  readonly prj: string | null;
}

export async function shapefiles(archive: Uint8Array): Promise<readonly Shapefile[]> {
  const files = new Map(
    Object.entries(unzipSync(archive))
      .filter(([name]) => !name.startsWith("__MACOSX"))
      .map(([name, bytes]) => [name.toLowerCase(), { name, bytes }] as const),
  );
  const found = [...files].filter(([key]) => key.endsWith(".shp"));
  if (found.length === 0) throw new RefusedFile("the archive holds no shapefile (.shp)");
  const read = found.map(async ([key, { name, bytes }]) => {
    const beside = (ending: string) => files.get(key.replace(/shp$/, ending))?.bytes;
    const [dbf, cpg, prj] = [beside("dbf"), beside("cpg"), beside("prj")];
    // Without the .prj the library leaves coordinates unchanged; with it, it would assume the Earth.
    const parts = { shp: bytes, ...(dbf ? { dbf } : {}), ...(cpg ? { cpg: strFromU8(cpg) } : {}) };
    const { features } = await shp(parts);
    return {
      name:
        name
          .split("/")
          .pop()
          ?.replace(/\.shp$/i, "") ?? name,
      features,
      prj: prj ? strFromU8(prj).trim() : null,
    };
  });
  return Promise.all(read);
}
