/** The ground: 3D tiles of every stop with levels of detail, and models that are one file. */

import { TilesRenderer } from "3d-tiles-renderer/three";
import { GLTFExtensionsPlugin } from "3d-tiles-renderer/three/plugins";
import {
  Box3,
  type BufferAttribute,
  Float32BufferAttribute,
  Group,
  type InterleavedBufferAttribute,
  type Intersection,
  type Material,
  Matrix4,
  Mesh,
  MeshBasicMaterial,
  MeshLambertMaterial,
  type Object3D,
  type Raycaster,
  Vector3,
} from "three";
import decoderWasm from "three/examples/jsm/libs/draco/gltf/draco_decoder.wasm?url";
import decoderWrapper from "three/examples/jsm/libs/draco/gltf/draco_wasm_wrapper.js?url";
import { DRACOLoader } from "three/examples/jsm/loaders/DRACOLoader.js";
import { GLTFLoader } from "three/examples/jsm/loaders/GLTFLoader.js";
import type { Bounds } from "../../../server/records";
import type { Model, Place3 } from "../../../server/scene";
import { Cover } from "./cover";
import type { Draped } from "./drape";
import type { Join } from "./join";
import type { Partition } from "./partition";

/** Photograph; photograph with additional light; grey in that light only. */
export type Shading = "photograph" | "lit" | "relief";

interface Ground {
  readonly model: Model;
  readonly group: Object3D;
  readonly tiles: TilesRenderer | null;
}

interface Materials {
  readonly photograph: Material;
  readonly lit: Material;
  readonly relief: Material;
  readonly cover: Cover;
  /** Vertices as in the file. */
  readonly places: BufferAttribute | InterleavedBufferAttribute;
  /** Layer draped over it. */
  draped: string;
  /** Correction by which it joins its neighbours now. */
  join: Join | null;
}

function materialsOf(mesh: Mesh, origin: Place3): Materials {
  const known = mesh.userData["materials"] as Materials | undefined;
  if (known) return known;
  const loaded = mesh.material as MeshBasicMaterial;
  const cover = new Cover(origin);
  const materials: Materials = {
    photograph: cover.put(new MeshBasicMaterial({ map: loaded.map, side: loaded.side })),
    lit: cover.put(new MeshLambertMaterial({ map: loaded.map, side: loaded.side })),
    relief: cover.put(new MeshLambertMaterial({ color: 0xb9a48f, side: loaded.side })),
    cover,
    places: mesh.geometry.getAttribute("position"),
    draped: "",
    join: null,
  };
  mesh.userData["materials"] = materials;
  return materials;
}

/** Matrix from a mesh to a group above it in map coordinates; null: it is not shown there. */
function toMap(mesh: Mesh, group: Object3D): Matrix4 | null {
  const map = new Matrix4();
  let part: Object3D | null = mesh;
  for (; part && part !== group; part = part.parent) {
    if (part.matrixAutoUpdate) part.updateMatrix();
    map.premultiply(part.matrix);
  }
  return part && map;
}

function boundsOf(mesh: Mesh, map: Matrix4): Bounds {
  mesh.geometry.computeBoundingBox();
  const { min, max } = (mesh.geometry.boundingBox ?? new Box3()).clone().applyMatrix4(map);
  return [min.x, min.y, max.x, max.y];
}

/** Raises the vertices of a mesh so that it joins its neighbours; null: puts them back. */
function raise({ geometry }: Mesh, { places }: Materials, join: Join | null, map: Matrix4): void {
  const back = map.clone().invert();
  const place = new Vector3();
  const raised = Array.from({ length: places.count }, (_, k) => {
    place.fromBufferAttribute(places, k).applyMatrix4(map);
    place.z += join?.rise([place.x, place.y]) ?? 0;
    return place.applyMatrix4(back).toArray();
  });
  geometry.setAttribute("position", join ? new Float32BufferAttribute(raised.flat(), 3) : places);
  geometry.boundingBox = geometry.boundingSphere = null;
}

/** Image draped over a mesh of a stop's ground; null: none. */
export type Draping = (scope: string, bounds: Bounds) => Promise<Draped | null>;

export class Terrain {
  readonly group = new Group();
  private readonly draco = new DRACOLoader();
  private readonly grounds: Ground[] = [];
  private waiting = 0;
  private current: Shading = "photograph";
  private stop: string | null = null;
  private draping: { readonly name: string; readonly of: Draping } | null = null;
  private partitions: readonly Partition[] = [];
  /** Ground by stop; null while it is loading. */
  private readonly joins = new Map<string, Join | null>();

  constructor(
    readonly origin: Place3,
    private readonly requestFrame: () => void,
    private readonly onSettled: () => void,
    private readonly onError: (reason: Error) => void,
  ) {
    this.draco.setDecoderPath({ js: decoderWrapper, wasm: decoderWasm });
  }

  /** Adds the models of one kind that belong together; tilesets and single files alike. */
  add(models: readonly Model[]): void {
    for (const model of models)
      this.grounds.push(model.kind === "tileset" ? this.tileset(model) : this.file(model));
    this.requestFrame();
  }

  /** Shows the ground of one stop, or of all. */
  show(scope: string | null): void {
    this.stop = scope;
    for (const { group, model } of this.grounds)
      group.visible = scope === null || model.scope === scope;
    this.updateMaterials();
  }

  /** Shows one surface at every place of some partitions when the ground of all stops is shown. */
  async part(coming: Promise<readonly Partition[]>): Promise<void> {
    await this.await(async () => {
      this.partitions = await coming;
      this.updateMaterials();
    });
  }

  set shading(shading: Shading) {
    this.current = shading;
    this.updateMaterials();
  }

  /** Drapes a layer over the ground, under a name unique to the layer; null removes it. */
  drape(name: string, of: Draping | null): void {
    this.draping = of && { name, of };
    this.updateMaterials();
  }

  get isSettled(): boolean {
    const loading = this.grounds.some(
      ({ tiles, group }) =>
        tiles !== null && group.visible && (tiles.root === null || tiles.loadProgress < 1),
    );
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

  /** The first ground that a ray meets and that is shown. */
  hit(ray: Raycaster): Intersection | null {
    const [east, north] = this.origin;
    const first = ({ group, model: { scope } }: Ground) => {
      const partition = this.partitionOf(scope);
      const isShown = ({ object, point }: Intersection) =>
        object instanceof Mesh &&
        (partition?.shows(scope, [point.x + east, point.y + north]) ?? true);
      return ray.intersectObject(group, true).find(isShown);
    };
    const met = this.grounds.filter(({ group }) => group.visible).map(first);
    const [nearest] = met
      .filter((one) => one !== undefined)
      .sort((a, b) => a.distance - b.distance);
    return nearest ?? null;
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
    for (const partition of this.partitions) partition.dispose();
    this.draco.dispose();
  }

  private tileset(model: Model): Ground {
    const tiles = new TilesRenderer(new URL(model.open, location.href).toString());
    tiles.registerPlugin(new GLTFExtensionsPlugin({ dracoLoader: this.draco, autoDispose: false }));
    const ground: Ground = { model, group: tiles.group, tiles };
    tiles.addEventListener("load-model", ({ scene }) => this.updateMaterialsBelow(ground, scene));
    tiles.addEventListener("dispose-model", ({ scene }) => {
      scene.traverse((thing) => {
        if (thing instanceof Mesh) materialsOf(thing, this.origin).cover.drape(null, null);
      });
    });
    tiles.addEventListener("needs-update", this.requestFrame);
    tiles.addEventListener("load-root-tileset", this.requestFrame);
    tiles.addEventListener("tile-visibility-change", ({ scene, visible }) => {
      if (visible && scene) this.updateMaterialsBelow(ground, scene);
      this.requestFrame();
    });
    tiles.addEventListener("load-error", ({ error }) => this.onError(error));
    tiles.addEventListener("tiles-load-end", () => {
      this.requestFrame();
      this.onSettled();
    });
    return this.placed(ground);
  }

  private file(model: Model): Ground {
    const group = new Group();
    const ground: Ground = { model, group, tiles: null };
    const loader = new GLTFLoader().setDRACOLoader(this.draco);
    this.waiting += 1;
    const end = () => {
      this.waiting -= 1;
      this.requestFrame();
      this.onSettled();
    };
    loader
      .loadAsync(model.open)
      .then(({ scene }) => {
        scene.rotation.x = Math.PI / 2; // y up in the file, z up here
        group.add(scene);
        this.updateMaterialsBelow(ground, scene);
      })
      .catch((reason: unknown) => this.onError(reason as Error))
      .finally(end);
    return this.placed(ground);
  }

  private placed(ground: Ground): Ground {
    const [east, north, up] = this.origin;
    ground.group.position.set(-east, -north, -up);
    this.group.add(ground.group);
    return ground;
  }

  private partitionOf(scope: string): Partition | null {
    return (this.stop === null && this.partitions.find((one) => one.has(scope))) || null;
  }

  private updateMaterials(): void {
    for (const ground of this.grounds) this.updateMaterialsBelow(ground, ground.group);
  }

  private updateMaterialsBelow(ground: Ground, part: Object3D): void {
    part.traverse((thing) => {
      if (thing instanceof Mesh) this.updateMaterial(thing, ground);
    });
    this.requestFrame();
  }

  private updateMaterial(mesh: Mesh, { model: { scope }, group }: Ground): void {
    const materials = materialsOf(mesh, this.origin);
    mesh.material = materials[this.current];
    const map = toMap(mesh, group);
    const partition = this.partitionOf(scope);
    materials.cover.part(partition, scope);
    const join = (partition && this.joinOf(partition, scope)) ?? null;
    if (map && materials.join !== join) {
      materials.join = join;
      raise(mesh, materials, join, map);
    }
    const name = this.draping ? `${this.draping.name} ${this.stop === null}` : "";
    if (materials.draped === name) return;
    if (!map) return;
    materials.draped = name;
    if (!this.draping) materials.cover.drape(null, null);
    else void this.drapeOver(materials, this.draping.of(scope, boundsOf(mesh, map)), name);
  }

  /** How a stop joins its neighbours; null until that is known. */
  private joinOf(partition: Partition, scope: string): Join | null {
    const known = this.joins.get(scope);
    if (known !== undefined) return known;
    this.joins.set(scope, null);
    void this.await(async () => {
      this.joins.set(scope, await partition.join(scope));
      this.updateMaterials();
    });
    return null;
  }

  private async drapeOver(materials: Materials, coming: Promise<Draped | null>, name: string) {
    await this.await(async () => {
      const draped = await coming;
      if (materials.draped === name)
        materials.cover.drape(draped?.texture ?? null, draped?.bounds ?? null);
      else draped?.texture.dispose();
    });
  }

  /** The ground counts as loading until some work is done. */
  private async await(work: () => Promise<void>): Promise<void> {
    this.waiting += 1;
    try {
      await work();
    } catch (reason) {
      this.onError(reason as Error);
    } finally {
      this.waiting -= 1;
      this.requestFrame();
      this.onSettled();
    }
  }
}
