/**
 * The stage: renderer, camera and light. All objects are children of one group in (east, north, up) metres from a nearby
 * origin, because graphics cards compute with seven digits; its z axis may be exaggerated. Frames are drawn on request.
 */

import {
  AmbientLight,
  DirectionalLight,
  Group,
  PerspectiveCamera,
  Raycaster,
  Scene,
  Vector2,
  Vector3,
  WebGLRenderer,
} from "three";
import { OrbitControls } from "three/examples/jsm/controls/OrbitControls.js";
import { AnaglyphEffect } from "three/examples/jsm/effects/AnaglyphEffect.js";
import type { Place3 } from "../../server/scene";
import { orbited, sunDirection } from "./geometry";
import { Backdrop } from "./surface/backdrop";

const FIELD_DEG = 45;
/** Radius of the ground as a share of its diagonal: the corners of its box are empty. */
const FILLING = 0.3;
/** Distance of the eyes as a share of the distance to the target, comfortable for viewing. */
const EYES = 1 / 30;

export class Stage {
  readonly world = new Group();
  readonly camera = new PerspectiveCamera(FIELD_DEG, 1, 0.05, 20_000);
  readonly controls: OrbitControls;
  readonly renderer: WebGLRenderer;
  readonly raycaster = new Raycaster();
  /** Called before every frame. */
  onFrame: () => void = () => undefined;
  private readonly scene = new Scene();
  private readonly sun = new DirectionalLight(0xffffff, 2.6);
  private readonly resized: ResizeObserver;
  private readonly backdrop: Backdrop;
  private anaglyph: AnaglyphEffect | null = null;
  private frame = 0;

  constructor(
    readonly host: HTMLElement,
    readonly origin: Place3,
    /** Elevation of level ground beyond the data. */
    private readonly lowest: number,
  ) {
    this.renderer = new WebGLRenderer({ antialias: true });
    this.renderer.setPixelRatio(Math.min(devicePixelRatio, 2));
    const canvas = this.renderer.domElement;
    host.append(canvas);
    this.backdrop = new Backdrop(host, this.requestFrame);
    this.scene.add(this.backdrop.sphere, this.world, this.sun, new AmbientLight(0xffffff, 0.55));
    this.camera.up.set(0, 0, 1);
    this.controls = new OrbitControls(this.camera, canvas);
    this.controls.addEventListener("change", this.requestFrame);
    this.resized = new ResizeObserver(() => this.fit());
    this.resized.observe(host);
    this.fit();
  }

  /** Requests a frame; several requests draw one frame. */
  readonly requestFrame = (): void => {
    if (this.frame) return;
    this.frame = requestAnimationFrame(() => {
      this.frame = 0;
      this.draw();
    });
  };

  get exaggeration(): number {
    return this.world.scale.z;
  }

  set exaggeration(factor: number) {
    const share = factor / this.world.scale.z;
    this.controls.target.z *= share;
    this.camera.position.z *= share;
    this.world.scale.z = factor;
    this.controls.update();
    this.requestFrame();
  }

  /** Sets the direction of the light: azimuth clockwise from north, elevation above the horizon, degrees. */
  lightFrom(azimuthDeg: number, elevationDeg: number): void {
    this.sun.position.set(...sunDirection(azimuthDeg, elevationDeg));
    this.requestFrame();
  }

  set isAnaglyph(on: boolean) {
    this.anaglyph?.dispose();
    this.anaglyph = on ? new AnaglyphEffect(this.renderer) : null;
    this.fit();
  }

  /** A place of the map in the coordinates that are drawn. */
  drawn([east, north, up]: Place3): Vector3 {
    const [e, n, u] = this.origin;
    return new Vector3(east - e, north - n, (up - u) * this.exaggeration);
  }

  /** The place of the map for a point of the drawing. */
  place({ x, y, z }: Vector3): Place3 {
    const [e, n, u] = this.origin;
    return [x + e, y + n, z / this.exaggeration + u];
  }

  /** The distance from which ground of a size, seen obliquely, fills the view. */
  distanceFor(size: number): number {
    const half = Math.tan((FIELD_DEG / 2) * (Math.PI / 180));
    return (FILLING * size) / half / Math.min(1, this.camera.aspect);
  }

  /** Looks from one place to another. */
  look(from: Place3, to: Place3): void {
    this.camera.position.copy(this.drawn(from));
    this.controls.target.copy(this.drawn(to));
    this.controls.update();
    this.requestFrame();
  }

  /** Turns about the target, or moves towards it. */
  orbit(turn: Parameters<typeof orbited>[1]): void {
    const { x, y, z } = this.camera.position.clone().sub(this.controls.target);
    const offset = new Vector3(...orbited([x, y, z], turn));
    this.camera.position.copy(this.controls.target).add(offset);
    this.controls.update();
    this.requestFrame();
  }

  /** Points a ray at a pixel of the canvas. */
  aim(x: number, y: number): Raycaster {
    const { clientWidth, clientHeight } = this.renderer.domElement;
    const at = new Vector2((2 * x) / clientWidth - 1, 1 - (2 * y) / clientHeight);
    this.raycaster.setFromCamera(at, this.camera);
    return this.raycaster;
  }

  dispose(): void {
    cancelAnimationFrame(this.frame);
    this.frame = -1; // no frame is drawn from now on
    this.resized.disconnect();
    this.anaglyph?.dispose();
    this.backdrop.dispose();
    this.controls.dispose();
    this.renderer.dispose();
    this.renderer.domElement.remove();
  }

  private fit(): void {
    const { clientWidth: width, clientHeight: height } = this.host;
    if (width === 0 || height === 0) return;
    this.camera.aspect = width / height;
    this.camera.updateProjectionMatrix();
    if (this.anaglyph) this.anaglyph.setSize(width, height);
    else this.renderer.setSize(width, height);
    this.requestFrame();
  }

  private draw(): void {
    this.backdrop.level = (this.lowest - this.origin[2]) * this.exaggeration;
    this.scene.updateMatrixWorld();
    this.camera.updateMatrixWorld();
    this.onFrame();
    if (!this.anaglyph) {
      this.renderer.render(this.scene, this.camera);
      return;
    }
    this.anaglyph.planeDistance = this.camera.position.distanceTo(this.controls.target);
    this.anaglyph.eyeSep = EYES * this.anaglyph.planeDistance;
    this.anaglyph.render(this.scene, this.camera);
  }
}
