/** The dense stereo points of the stops: tiles of points that add to each other, the nearer the finer. */

import { TilesRenderer } from "3d-tiles-renderer/three";
import {
  Group,
  type Object3D,
  type PerspectiveCamera,
  Points,
  PointsMaterial,
  type WebGLRenderer,
} from "three";
import type { Model, Place3 } from "../../../server/scene";

interface Part {
  readonly model: Model;
  readonly tiles: TilesRenderer;
}

export class Cloud {
  readonly group = new Group();
  private readonly parts: readonly Part[];
  private readonly material: PointsMaterial;

  constructor(
    models: readonly Model[],
    origin: Place3,
    sizePx: number,
    private readonly requestFrame: () => void,
    private readonly onSettled: () => void,
    private readonly onError: (reason: Error) => void,
  ) {
    this.material = new PointsMaterial({
      size: sizePx,
      sizeAttenuation: false,
      vertexColors: true,
    });
    this.parts = models.map((model) => ({ model, tiles: this.tiles(model, origin) }));
  }

  set size(px: number) {
    this.material.size = px;
    this.requestFrame();
  }

  /** Shows the points of one stop, or of all. */
  show(scope: string | null): void {
    for (const { model, tiles } of this.parts)
      tiles.group.visible = scope === null || model.scope === scope;
    this.requestFrame();
  }

  get isSettled(): boolean {
    return this.parts.every(
      ({ tiles }) => !tiles.group.visible || (tiles.root !== null && tiles.loadProgress === 1),
    );
  }

  /** Points that are on the screen or around it now. */
  get count(): number {
    let count = 0;
    this.group.traverseVisible((thing) => {
      if (thing instanceof Points) count += thing.geometry.getAttribute("position").count;
    });
    return count;
  }

  update(camera: PerspectiveCamera, renderer: WebGLRenderer): void {
    if (!this.group.visible) return;
    for (const { tiles } of this.parts) {
      if (!tiles.group.visible) continue;
      tiles.setCamera(camera);
      tiles.setResolutionFromRenderer(camera, renderer);
      tiles.update();
    }
  }

  dispose(): void {
    for (const { tiles } of this.parts) tiles.dispose();
    this.material.dispose();
  }

  private tiles(model: Model, [east, north, up]: Place3): TilesRenderer {
    const tiles = new TilesRenderer(new URL(model.open, location.href).toString());
    tiles.addEventListener("load-model", ({ scene }: { readonly scene: Object3D }) => {
      scene.traverse((thing) => {
        if (thing instanceof Points) thing.material = this.material;
      });
      this.requestFrame();
    });
    for (const event of ["needs-update", "load-root-tileset", "tile-visibility-change"] as const)
      tiles.addEventListener(event, this.requestFrame);
    tiles.addEventListener("load-error", ({ error }) => this.onError(error));
    tiles.addEventListener("tiles-load-end", () => {
      this.requestFrame();
      this.onSettled();
    });
    tiles.group.position.set(-east, -north, -up);
    this.group.add(tiles.group);
    return tiles;
  }
}
