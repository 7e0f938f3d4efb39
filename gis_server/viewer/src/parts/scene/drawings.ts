/** Lines, points and figures besides the ground, relative to an origin: children of the stage's world. */

import {
  BufferGeometry,
  CanvasTexture,
  Float32BufferAttribute,
  Group,
  Matrix4,
  Mesh,
  MeshBasicMaterial,
  type Object3D,
  Points,
  PointsMaterial,
  SphereGeometry,
  SRGBColorSpace,
  Sprite,
  SpriteMaterial,
  Vector2,
  Vector3,
} from "three";
import { LineMaterial } from "three/examples/jsm/lines/LineMaterial.js";
import { LineSegments2 } from "three/examples/jsm/lines/LineSegments2.js";
import { LineSegmentsGeometry } from "three/examples/jsm/lines/LineSegmentsGeometry.js";
import type { Place3, SceneStop } from "../../server/scene";
import { sum } from "./geometry";

/** Height of a nameplate; its letters have two thirds of it. */
const NAME_PX = 26;

export interface Stroke {
  readonly color: string;
  readonly width: number;
  readonly dashed?: boolean;
  /** Drawn also where ground is in front of it. */
  readonly above?: boolean;
}

const flat = (places: readonly Place3[], origin: Place3) =>
  places.flatMap((place) => sum(place, origin, -1));

/** Every two places are a line. */
export function segments(places: readonly Place3[], origin: Place3, stroke: Stroke): LineSegments2 {
  const geometry = new LineSegmentsGeometry();
  geometry.setPositions(flat(places, origin));
  const material = new LineMaterial({
    color: stroke.color,
    linewidth: stroke.width,
    dashed: stroke.dashed ?? false,
    dashSize: 0.5,
    gapSize: 0.35,
    depthTest: !stroke.above,
    transparent: true,
  });
  const drawn = new LineSegments2(geometry, material);
  if (stroke.dashed) drawn.computeLineDistances();
  if (stroke.above) drawn.renderOrder = 5;
  return drawn;
}

/** A line through all places. */
export const path = (places: readonly Place3[], origin: Place3, stroke: Stroke): LineSegments2 =>
  segments(
    places.slice(1).flatMap((place, k) => [places[k] ?? place, place]),
    origin,
    stroke,
  );

export function dots(places: readonly Place3[], origin: Place3, color: string, px: number): Points {
  const geometry = new BufferGeometry();
  geometry.setAttribute("position", new Float32BufferAttribute(flat(places, origin), 3));
  return new Points(geometry, new PointsMaterial({ color, size: px, sizeAttenuation: false }));
}

/** A name that faces the viewer, as high on any screen. */
export function nameplate(text: string, place: Place3, origin: Place3): Sprite {
  const canvas = document.createElement("canvas");
  const pen = canvas.getContext("2d");
  [canvas.width, canvas.height] = [256, 64];
  if (pen) {
    pen.font = "600 40px system-ui, sans-serif";
    pen.textAlign = "center";
    pen.lineWidth = 8;
    pen.strokeStyle = "white";
    pen.strokeText(text, 128, 46);
    pen.fillStyle = "#7d0f0a";
    pen.fillText(text, 128, 46);
  }
  const map = new CanvasTexture(canvas);
  map.colorSpace = SRGBColorSpace;
  const sprite = new Sprite(new SpriteMaterial({ map, depthTest: false, sizeAttenuation: false }));
  sprite.onBeforeRender = (renderer, _, camera) => {
    // A sprite that is not attenuated has its size at a distance of one.
    const perPx =
      2 / renderer.getSize(new Vector2()).y / (camera.projectionMatrix.elements[5] ?? 1);
    sprite.scale.set(4 * NAME_PX * perPx, NAME_PX * perPx, 1);
    sprite.updateMatrixWorld();
  };
  sprite.center.set(0.5, -0.4);
  sprite.position.set(...sum(place, origin, -1));
  sprite.renderOrder = 7;
  return sprite;
}

/** A stop's standard error ellipsoid, so many times as large; nothing for a stop that defines the datum. */
export function ellipsoid(stop: SceneStop, origin: Place3, factor: number): Object3D {
  const { semi_axes_m: axes, directions } = stop.ellipsoid;
  if (stop.held || axes[0] <= 0) return new Group();
  const material = new MeshBasicMaterial({ color: "#e02d25", transparent: true, opacity: 0.35 });
  const figure = new Mesh(new SphereGeometry(1, 24, 16), material);
  const columns = directions.map((direction, k) =>
    new Vector3(...direction).multiplyScalar(Math.max(factor * (axes[k] ?? 0), 1e-4)),
  );
  const [x = new Vector3(), y = new Vector3(), z = new Vector3()] = columns;
  figure.matrixAutoUpdate = false;
  figure.matrix = new Matrix4().makeBasis(x, y, z).setPosition(...sum(stop.place, origin, -1));
  return figure;
}

/** Frees the memory of an object on the graphics card. */
export function discard(thing: Object3D): void {
  thing.traverse((part) => {
    if (part instanceof Mesh || part instanceof Points || part instanceof Sprite) {
      part.geometry.dispose();
      const material = part.material as { dispose(): void; map?: { dispose(): void } | null };
      material.map?.dispose();
      material.dispose();
    }
  });
  thing.removeFromParent();
}
