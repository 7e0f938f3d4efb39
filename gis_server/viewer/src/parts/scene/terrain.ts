/** The ground: 3D tiles of every stop with levels of detail, and models that are one file. */

import { TilesRenderer } from "3d-tiles-renderer/three";
import { GLTFExtensionsPlugin } from "3d-tiles-renderer/three/plugins";
import {
  Group,
  type Intersection,
  type Material,
  Mesh,
  MeshBasicMaterial,
  MeshLambertMaterial,
  type Object3D,
  type Raycaster,
} from "three";
import decoderWasm from "three/examples/jsm/libs/draco/gltf/draco_decoder.wasm?url";
import decoderWrapper from "three/examples/jsm/libs/draco/gltf/draco_wasm_wrapper.js?url";
import { DRACOLoader } from "three/examples/jsm/loaders/DRACOLoader.js";
import { GLTFLoader } from "three/examples/jsm/loaders/GLTFLoader.js";
import type { Model, Place3 } from "../../server/scene";

/** As photographed; the photograph in another light besides its own; grey in that light alone. */
export type Look = "photograph" | "lit" | "relief";

interface Ground {
  readonly model: Model;
  readonly group: Object3D;
  readonly tiles: TilesRenderer | null;
}

interface Clothes {
  readonly photograph: Material;
  readonly lit: Material;
  readonly relief: Material;
}

function clothesOf(mesh: Mesh): Clothes {
  const known = mesh.userData["clothes"] as Clothes | undefined;
  if (known) return known;
  const worn = mesh.material as MeshBasicMaterial;
  const clothes: Clothes = {
    photograph: new MeshBasicMaterial({ map: worn.map, side: worn.side }),
    lit: new MeshLambertMaterial({ map: worn.map, side: worn.side }),
    relief: new MeshLambertMaterial({ color: 0xb9a48f, side: worn.side }),
  };
  mesh.userData["clothes"] = clothes;
  return clothes;
}

export class Terrain {
  readonly group = new Group();
  private readonly draco = new DRACOLoader();
  private readonly grounds: Ground[] = [];
  private waiting = 0;
  private worn: Look = "photograph";

  constructor(
    readonly origin: Place3,
    private readonly ask: () => void,
    private readonly onSettled: () => void,
    private readonly onError: (reason: Error) => void,
  ) {
    this.draco.setDecoderPath({ js: decoderWrapper, wasm: decoderWasm });
  }

  /** Adds the models of one kind that belong together; tilesets and single files alike. */
  add(models: readonly Model[]): void {
    for (const model of models)
      this.grounds.push(model.kind === "tileset" ? this.tileset(model) : this.file(model));
    this.ask();
  }

  /** Shows the ground of one stop, or of all. */
  show(scope: string | null): void {
    for (const { group, model } of this.grounds)
      group.visible = scope === null || model.scope === scope;
    this.ask();
  }

  set look(look: Look) {
    this.worn = look;
    this.group.traverse((thing) => {
      if (thing instanceof Mesh) this.dress(thing);
    });
    this.ask();
  }

  get isSettled(): boolean {
    const loading = this.grounds.some(({ tiles }) => tiles !== null && tiles.loadProgress < 1);
    return this.waiting === 0 && !loading;
  }

  /** Chooses the levels of detail for what the camera sees. */
  update(camera: import("three").PerspectiveCamera, renderer: import("three").WebGLRenderer): void {
    for (const { tiles, group } of this.grounds) {
      if (!tiles || !group.visible) continue;
      tiles.setCamera(camera);
      tiles.setResolutionFromRenderer(camera, renderer);
      tiles.update();
    }
  }

  /** The first ground that a ray meets. */
  hit(ray: Raycaster): Intersection | null {
    const seen = this.grounds.filter(({ group }) => group.visible).map(({ group }) => group);
    return ray.intersectObjects(seen, true).find(({ object }) => object instanceof Mesh) ?? null;
  }

  get triangles(): number {
    let count = 0;
    this.group.traverseVisible((thing) => {
      if (thing instanceof Mesh) count += (thing.geometry.index?.count ?? 0) / 3;
    });
    return count;
  }

  dispose(): void {
    for (const { tiles } of this.grounds) tiles?.dispose();
    this.draco.dispose();
  }

  private tileset(model: Model): Ground {
    const tiles = new TilesRenderer(new URL(model.open, location.href).toString());
    tiles.registerPlugin(new GLTFExtensionsPlugin({ dracoLoader: this.draco, autoDispose: false }));
    tiles.addEventListener("load-model", ({ scene }) => {
      scene.traverse((thing) => {
        if (thing instanceof Mesh) this.dress(thing);
      });
      this.ask();
    });
    tiles.addEventListener("needs-update", this.ask);
    tiles.addEventListener("load-root-tileset", this.ask);
    tiles.addEventListener("tile-visibility-change", this.ask);
    tiles.addEventListener("load-error", ({ error }) => this.onError(error));
    tiles.addEventListener("tiles-load-end", () => {
      this.ask();
      this.onSettled();
    });
    return this.placed({ model, group: tiles.group, tiles });
  }

  private file(model: Model): Ground {
    const group = new Group();
    const loader = new GLTFLoader().setDRACOLoader(this.draco);
    this.waiting += 1;
    const end = () => {
      this.waiting -= 1;
      this.ask();
      this.onSettled();
    };
    loader
      .loadAsync(model.open)
      .then(({ scene }) => {
        scene.rotation.x = Math.PI / 2; // y up in the file, z up here
        scene.traverse((thing) => {
          if (thing instanceof Mesh) this.dress(thing);
        });
        group.add(scene);
      })
      .catch((reason: unknown) => this.onError(reason as Error))
      .finally(end);
    return this.placed({ model, group, tiles: null });
  }

  private placed(ground: Ground): Ground {
    const [east, north, up] = this.origin;
    ground.group.position.set(-east, -north, -up);
    this.group.add(ground.group);
    return ground;
  }

  private dress(mesh: Mesh): void {
    mesh.material = clothesOf(mesh)[this.worn];
  }
}
