/** Features of a file as draft annotations. */

import type { GeoJsonFeature } from "../../map/mars-geojson";
import { moved } from "../../map/mars-geojson";
import type { AnnotationEdit } from "../../server/edits";
import type { FileFeatures } from "./read";

/** Names of attributes that describe a feature. */
const NAMES = ["text", "name", "title", "label", "description"];
const LONGEST = 4000;
/** Millimetres are enough for what was drawn. */
const MM = 1000;

const flat = ([east = 0, north = 0]: readonly number[]) =>
  [east, north].map((metres) => Math.round(metres * MM) / MM);

export function textOf({ properties }: GeoJsonFeature, otherwise: string): string {
  const known = Object.entries(properties ?? {}).map(([key, value]) => [key.toLowerCase(), value]);
  const named = NAMES.map((name) => known.find(([key]) => key === name)?.[1]);
  const text = named.find((value) => typeof value === "string" && value.trim() !== "");
  return String(text ?? otherwise)
    .trim()
    .slice(0, LONGEST);
}

/** One for every point, line and polygon; those of several parts become several. */
export function annotationsOf({ name, features }: FileFeatures): readonly AnnotationEdit[] {
  return features.flatMap((feature) => {
    const { geometry } = feature;
    if (!geometry) return [];
    const coordinates = moved(geometry.coordinates, flat);
    const isMany = geometry.type.startsWith("Multi");
    const type = geometry.type.replace(/^Multi/, "");
    const parts = isMany ? (coordinates as readonly unknown[]) : [coordinates];
    const text = textOf(feature, name);
    return parts.map(
      (part): AnnotationEdit => ({
        geometry: { type, coordinates: part },
        text,
        category: "note",
        state: "draft",
      }),
    );
  });
}
