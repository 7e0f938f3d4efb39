/** Footprint and pointing line of an image, fetched by its name and cached. */

import type Feature from "ol/Feature";
import type Geometry from "ol/geom/Geometry";
import { api } from "../server/api";
import type { Layer } from "../server/records";
import { readFeatures } from "./map-layers";

const MOST_KEPT = 200;

export class ImageFeatures {
  private readonly kept = new Map<string, Promise<Feature<Geometry>[]>>();

  /** `layers` are those of footprints and pointing lines. */
  constructor(private readonly layers: () => readonly Layer[]) {}

  /** Outline and line of an image, one of each, from the layers of the widest scope. */
  of(image: string): Promise<Feature<Geometry>[]> {
    const known = this.kept.get(image);
    if (known) return known;
    const loading = this.load(image).catch((reason: unknown) => {
      this.kept.delete(image);
      throw reason;
    });
    if (this.kept.size >= MOST_KEPT) this.forget();
    this.kept.set(image, loading);
    return loading;
  }

  /** Layers may have new products. */
  forget(): void {
    this.kept.clear();
  }

  private async load(image: string): Promise<Feature<Geometry>[]> {
    const vectors = this.layers().filter((layer) => layer.type === "vector");
    const found = await Promise.all(vectors.map((layer) => api.featuresNamed(layer, [image])));
    return found.flatMap(readFeatures);
  }
}
