/** Kinds of measurements, and their results. */

import type { Shape } from "../../map/sketch";
import type { ChartOptions } from "../../page/chart";
import type { LayerUsed, Profile } from "../../server/measure";
import type { Bounds, MapPoint } from "../../server/records";
import type { Measured } from "../../session/state";
import type { Quantity } from "./quantities";

/** An image overlaid on the map. */
export interface Overlay {
  readonly url: string;
  readonly bounds: Bounds;
  /** URL of the result as a GeoTIFF. */
  readonly geotiff: string;
}

/** Result of a measurement. */
export interface Found {
  readonly quantities: readonly Quantity[];
  /** Index of the main quantity. */
  readonly main: number;
  readonly layers: readonly LayerUsed[];
  readonly note?: string | null;
  readonly profile?: Profile;
  /** Another chart along what was drawn. */
  readonly chart?: Omit<ChartOptions, "onCursor">;
  /** A marked place. */
  readonly mark?: MapPoint | null;
  readonly overlay?: Overlay;
  /** A route that differs from the drawn line. */
  readonly way?: readonly MapPoint[];
}

/** A number in metres that is entered before drawing. */
export interface NumberField {
  readonly key: string;
  readonly title: string;
  readonly usual: number;
  readonly least: number;
  readonly most: number;
  readonly step: number;
}

/** Choices besides the corners. */
export interface Inputs {
  readonly layer: string | null;
  readonly numbers: Readonly<Record<string, number>>;
}

export interface Mode {
  readonly key: Measured["mode"];
  readonly title: string;
  readonly shape: Shape;
  /** Corners that are needed, and at which a line or a choice of points ends by itself. */
  readonly least: number;
  readonly most?: number;
  readonly hint: string;
  /** The text shown while the shape is drawn. */
  readonly live: (corners: readonly MapPoint[]) => string;
  /** Whether a raster layer is to be chosen for it. */
  readonly needsLayer?: boolean;
  readonly numberFields?: readonly NumberField[];
  readonly find: (mission: string, corners: readonly MapPoint[], inputs: Inputs) => Promise<Found>;
}

/** The result; `main` is the index of its main quantity. */
export function found(
  quantities: readonly Quantity[],
  main: string,
  layers: readonly LayerUsed[],
  more: Partial<Found> = {},
): Found {
  const at = quantities.findIndex((one) => one.name === main);
  return { quantities, main: Math.max(0, at), layers, ...more };
}

/** The chosen number, limited to its range; else the default. */
export function chosenNumber({ usual, least, most }: NumberField, chosen?: number): number {
  if (chosen === undefined || !Number.isFinite(chosen)) return usual;
  return Math.min(most, Math.max(least, chosen));
}
