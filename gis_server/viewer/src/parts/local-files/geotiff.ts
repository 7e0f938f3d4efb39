/** A GeoTIFF as an image: of a band, grey from 2 % to 98 % of its values; of three or more, as red, green and blue. */

import { fromBlob, type GeoTIFFImage } from "geotiff";
import type { Bounds } from "../../server/records";
import { crsOf, type FileCrs, LOCAL, RefusedFile, type Target } from "./crs";
import type { FileImage } from "./read";

/** Larger rasters are shown coarser. */
const MOST_PX = 4096;
const SHARE = 0.02;
const SAMPLES = 10_000;

type Band = ArrayLike<number>;

export async function geotiff(file: File, target: Target): Promise<FileImage> {
  const tiff = await fromBlob(file);
  const image = await tiff.getImage();
  const crs = crsFrom(image.getGeoKeys() as GeoKeys | null, target);
  const bounds = image.getBoundingBox() as unknown as Bounds;
  const [wide, high] = [image.getWidth(), image.getHeight()];
  const scale = Math.min(1, MOST_PX / Math.max(wide, high));
  const [width, height] = [Math.round(wide * scale), Math.round(high * scale)];
  const isColour = image.getSamplesPerPixel() >= 3 && image.getBitsPerSample() === 8;
  const samples = isColour ? [0, 1, 2] : [0];
  const bands = (await tiff.readRasters({ bbox: [...bounds], width, height, samples })) as unknown;
  const url = await imageUrl(bands as Band[], width, height, nodataOf(image));
  const note = scale < 1 ? `shown at ${width} × ${height} of ${wide} × ${high} pixels` : "";
  return { type: "image", name: file.name, crs, extent: bounds, url, note };
}

const nodataOf = (image: GeoTIFFImage) => image.getGDALNoData() ?? Number.NaN;

async function imageUrl(
  bands: readonly Band[],
  width: number,
  height: number,
  nodata: number,
): Promise<string> {
  const canvas = new OffscreenCanvas(width, height);
  const context = canvas.getContext("2d");
  if (!context) throw new RefusedFile("this browser draws no canvas");
  const pixels = context.createImageData(width, height);
  const isThere = (value: number) => Number.isFinite(value) && value !== nodata;
  const [low, high] = bands.length === 1 && bands[0] ? stretch(bands[0], isThere) : [0, 255];
  const shade = (value: number) => (255 * (value - low)) / (high - low || 1);
  for (let k = 0; k < width * height; k++) {
    const values = [0, 1, 2].map((band) => (bands[band] ?? bands[0])?.[k] ?? Number.NaN);
    pixels.data.set([...values.map(shade), values.some(isThere) ? 255 : 0], 4 * k);
  }
  context.putImageData(pixels, 0, 0);
  return URL.createObjectURL(await canvas.convertToBlob());
}

function stretch(band: Band, isThere: (value: number) => boolean): readonly [number, number] {
  const step = Math.max(1, Math.floor(band.length / SAMPLES));
  const some: number[] = [];
  for (let k = 0; k < band.length; k += step) some.push(band[k] ?? Number.NaN);
  const known = some.filter(isThere).sort((a, b) => a - b);
  const at = (share: number) => known[Math.floor(share * (known.length - 1))] ?? 0;
  return [at(SHARE), at(1 - SHARE)];
}

type GeoKeys = Readonly<Record<string, number | string | undefined>>;

const [PROJECTED, GEOGRAPHIC] = [1, 2];
const POLAR = 15;
/** PROJ's names of the projections that maps of Mars are in, by `ProjCoordTransGeoKey`. */
const PROJECTIONS: Readonly<Record<number, string>> = {
  10: "laea",
  15: "stere",
  16: "stere",
  17: "eqc",
  21: "ortho",
  24: "sinu",
  1: "tmerc",
};

function crsFrom(keys: GeoKeys | null, target: Target): FileCrs {
  const number = (...names: readonly string[]) => {
    const found = names.map((name) => keys?.[name]).find((value) => typeof value === "number");
    return typeof found === "number" ? found : 0;
  };
  const a = number("GeogSemiMajorAxisGeoKey");
  const title = keys?.["GTCitationGeoKey"] ?? keys?.["GeogCitationGeoKey"] ?? "an unnamed system";
  if (!keys || !a)
    throw new RefusedFile(`it has no coordinate system of Mars, but ${keys ? title : "none"}`);
  const flattening = number("GeogInvFlatteningGeoKey");
  const b = number("GeogSemiMinorAxisGeoKey") || (flattening ? a * (1 - 1 / flattening) : a);
  const ellipsoid = `+a=${a} +b=${b} +no_defs`;
  if (number("GTModelTypeGeoKey") === GEOGRAPHIC)
    return crsOf(`+proj=longlat ${ellipsoid}`, target);
  const projection = PROJECTIONS[number("ProjCoordTransGeoKey")];
  if (number("GTModelTypeGeoKey") !== PROJECTED || !projection)
    throw new RefusedFile(`the projection of ${title} is not read here`);
  const lat = number("ProjCenterLatGeoKey", "ProjNatOriginLatGeoKey");
  const lon = number(
    "ProjCenterLongGeoKey",
    "ProjNatOriginLongGeoKey",
    "ProjStraightVertPoleLongGeoKey",
  );
  const isPolar = number("ProjCoordTransGeoKey") === POLAR;
  const parts = [
    `+proj=${projection} +lon_0=${lon}`,
    isPolar ? `+lat_0=${Math.sign(lat) * 90} +lat_ts=${lat}` : `+lat_0=${lat}`,
    projection === "eqc" ? `+lat_ts=${number("ProjStdParallel1GeoKey")}` : "",
    `+x_0=${number("ProjFalseEastingGeoKey")} +y_0=${number("ProjFalseNorthingGeoKey")}`,
    `+k_0=${number("ProjScaleAtNatOriginGeoKey") || 1} +units=m ${ellipsoid}`,
  ];
  const found = crsOf(parts.join(" "), target);
  return found === LOCAL ? found : { ...found, title: String(title) };
}
