/** Files that were dropped, read in the browser: what they hold, on the local map. */

import type { GeoJsonFeature } from "../../map/mars-geojson";
import type { Bounds } from "../../server/records";
import { crsNamed, crsOf, type FileCrs, RefusedFile, type Target } from "./crs";
import { boundsOf, onMap, placed } from "./features";

export interface FileFeatures {
  readonly type: "features";
  readonly name: string;
  readonly crs: FileCrs;
  /** Features in metres of the map. */
  readonly features: readonly GeoJsonFeature[];
}

export interface FileImage {
  readonly type: "image";
  readonly name: string;
  readonly crs: FileCrs;
  /** Extent in coordinates of the file. */
  readonly extent: Bounds;
  readonly url: string;
  /** Further properties that a reader needs. */
  readonly note: string;
}

export type FileLayer = FileFeatures | FileImage;

const FORMATS = "GeoJSON, GeoPackage, zipped shapefile and GeoTIFF";
const MOST_BYTES = 512e6;

/** The layers of a file; a GeoPackage or an archive may hold several. */
export async function readFile(file: File, target: Target): Promise<readonly FileLayer[]> {
  if (file.size > MOST_BYTES)
    throw new RefusedFile(`${file.name}: a browser reads files up to ${MOST_BYTES / 1e6} MB`);
  try {
    return await layersOf(file, target);
  } catch (reason) {
    const why = reason instanceof Error ? reason.message : String(reason);
    throw new RefusedFile(`${file.name}: ${why}`);
  }
}

async function layersOf(file: File, target: Target): Promise<readonly FileLayer[]> {
  const ending = file.name.split(".").pop()?.toLowerCase();
  switch (ending) {
    case "json":
    case "geojson":
      return [geojson(file.name, await file.text(), target)];
    case "zip": {
      const { shapefiles } = await import("./shapefile");
      return (await shapefiles(new Uint8Array(await file.arrayBuffer()))).map(
        ({ name, features, prj }) =>
          prj === null
            ? byNumbers(name, features, target)
            : layer(name, features, crsOf(prj, target)),
      );
    }
    case "gpkg": {
      const { geopackage } = await import("./geopackage");
      return (await geopackage(new Uint8Array(await file.arrayBuffer()))).map(
        ({ name, features, definition }) =>
          definition === null
            ? byNumbers(name, features, target)
            : layer(name, features, crsOf(definition, target)),
      );
    }
    case "tif":
    case "tiff": {
      const { geotiff } = await import("./geotiff");
      return [await geotiff(file, target)];
    }
    default:
      throw new RefusedFile(`this kind of file is not read: ${FORMATS} are`);
  }
}

function layer(name: string, features: readonly GeoJsonFeature[], crs: FileCrs): FileFeatures {
  const there = onMap(placed(features), crs);
  boundsOf(there); // refuses what lies nowhere on the map
  return { type: "features", name, crs, features: there };
}

const byNumbers = (name: string, features: readonly GeoJsonFeature[], target: Target) =>
  layer(name, features, crsNamed(null, boundsOf(placed(features)), target));

interface GeoJsonFile {
  readonly type?: string;
  readonly features?: readonly GeoJsonFeature[];
  readonly crs?: { readonly properties?: { readonly name?: unknown } } | null;
}

export function geojson(name: string, text: string, target: Target): FileFeatures {
  let file: GeoJsonFile & Partial<GeoJsonFeature>;
  try {
    file = JSON.parse(text) as typeof file;
  } catch {
    throw new RefusedFile("it is not JSON");
  }
  const features =
    file.type === "Feature"
      ? [file as GeoJsonFeature]
      : Array.isArray(file.features)
        ? file.features
        : null;
  if (!features) throw new RefusedFile("it is not GeoJSON: it has no features");
  const some = placed(features);
  const named = file.crs?.properties?.name;
  return layer(
    name,
    some,
    crsNamed(typeof named === "string" ? named : null, boundsOf(some), target),
  );
}
