/**
 * Additional textures of the ground's materials: an image that is draped over it, and a partition that hides ground of
 * which another stop has a better surface. Both are images over a box of the map.
 */

import { type Material, type Texture, Vector4 } from "three";
import type { Bounds } from "../../../server/records";
import type { Place3 } from "../../../server/scene";
import type { Partition } from "./partition";

const DECLARED_VERTEX = "varying vec2 vGround;\nvoid main() {";
const VERTEX = `#include <project_vertex>
vGround = (modelMatrix * vec4(transformed, 1.0)).xy;`;

const DECLARED_FRAGMENT = `
varying vec2 vGround;
uniform bool isParted;
uniform sampler2D stops;
uniform vec4 stopsBox;
uniform vec3 own[2];
uniform bool isDraped;
uniform sampler2D draped;
uniform vec4 drapedBox;
bool isOwn(vec2 at) {
  vec4 stop = texture2D(stops, at);
  return stop.a < 0.5 || distance(stop.rgb, own[0]) < 0.01 || distance(stop.rgb, own[1]) < 0.01;
}
void main() {`;
/** Surfaces of neighbours overlap by a texel of the partition, so that nothing shines through where they meet. */
const FRAGMENT = `#include <map_fragment>
if (isParted) {
  vec2 at = (vGround - stopsBox.xy) / stopsBox.zw;
  vec2 texel = 1.0 / vec2(textureSize(stops, 0));
  bool isInside = all(equal(at, clamp(at, 0.0, 1.0)));
  bool isShown = isOwn(at) || isOwn(at + vec2(texel.x, 0.0)) || isOwn(at - vec2(texel.x, 0.0))
    || isOwn(at + vec2(0.0, texel.y)) || isOwn(at - vec2(0.0, texel.y));
  if (isInside && !isShown) discard;
}
if (isDraped) {
  vec2 at = (vGround - drapedBox.xy) / drapedBox.zw;
  vec4 shown = texture2D(draped, at);
  if (all(equal(at, clamp(at, 0.0, 1.0))))
    diffuseColor.rgb = mix(diffuseColor.rgb, shown.rgb / max(shown.a, 1e-3), shown.a);
}`;

/** A box of the map in the coordinates that are drawn: its south-western corner and its size. */
const boxOf = ([west, south, east, north]: Bounds, [e, n]: Place3) =>
  new Vector4(west - e, south - n, east - west, north - south);

export class Cover {
  private readonly uniforms = {
    isParted: { value: false },
    stops: { value: null as Texture | null },
    stopsBox: { value: new Vector4(0, 0, 1, 1) },
    own: { value: [0, 0, 0, 0, 0, 0] },
    isDraped: { value: false },
    draped: { value: null as Texture | null },
    drapedBox: { value: new Vector4(0, 0, 1, 1) },
  };

  constructor(private readonly origin: Place3) {}

  /** Applies it to a material. */
  put<T extends Material>(material: T): T {
    material.onBeforeCompile = (shader) => {
      Object.assign(shader.uniforms, this.uniforms);
      shader.vertexShader = shader.vertexShader
        .replace("void main() {", DECLARED_VERTEX)
        .replace("#include <project_vertex>", VERTEX);
      shader.fragmentShader = shader.fragmentShader
        .replace("void main() {", DECLARED_FRAGMENT)
        .replace("#include <map_fragment>", FRAGMENT);
    };
    return material;
  }

  /** Hides ground that a partition assigns to other stops; null: hides nothing. */
  part(partition: Partition | null, scope: string): void {
    const { isParted, stops, stopsBox, own } = this.uniforms;
    isParted.value = partition !== null;
    if (!partition) return;
    stops.value = partition.texture;
    stopsBox.value = boxOf(partition.bounds, this.origin);
    own.value = [...partition.coloursOf(scope)];
  }

  /** Drapes an image over a box of the map; null removes it. */
  drape(texture: Texture | null, bounds: Bounds | null): void {
    const { isDraped, draped, drapedBox } = this.uniforms;
    draped.value?.dispose();
    draped.value = texture;
    isDraped.value = texture !== null;
    if (bounds) drapedBox.value = boxOf(bounds, this.origin);
  }
}
