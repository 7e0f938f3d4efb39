/**
 * The scene beyond the data: a sky from the haze at the horizon to the zenith, and level ground at the lowest elevation
 * of the data that fades into the haze with distance. One sphere around the eye, drawn before all else and without depth,
 * so that it covers nothing. Its colours are those of the style sheet (`.scene-tones`), of the light or the dark theme.
 */

import { BackSide, Color, Mesh, ShaderMaterial, SphereGeometry } from "three";
import { h } from "../../../page/dom";

/** Level ground is hidden by haze to 63 percent there. */
const HAZE_M = 1500;

const VERTEX = `
varying vec3 direction;
void main() {
  direction = position;
  gl_Position = projectionMatrix * vec4(mat3(viewMatrix) * position, 1.0);
}`;
const FRAGMENT = `
uniform vec3 zenith;
uniform vec3 horizon;
uniform vec3 ground;
uniform float level;
varying vec3 direction;
void main() {
  float up = normalize(direction).z;
  vec3 shown = mix(horizon, zenith, pow(max(up, 0.0), 0.6));
  if (up < 0.0) {
    float distance = max(cameraPosition.z - level, 0.0) / -up;
    shown = mix(ground, horizon, 1.0 - exp(-distance / ${HAZE_M.toFixed(1)}));
  }
  gl_FragColor = vec4(shown, 1.0);
  #include <colorspace_fragment>
}`;

export class Backdrop {
  private readonly tones = h("i", { class: "scene-tones", hidden: true });
  private readonly uniforms = {
    zenith: { value: new Color() },
    horizon: { value: new Color() },
    ground: { value: new Color() },
    level: { value: 0 },
  };
  readonly sphere = new Mesh(
    new SphereGeometry(10, 32, 32),
    new ShaderMaterial({
      uniforms: this.uniforms,
      vertexShader: VERTEX,
      fragmentShader: FRAGMENT,
      side: BackSide,
      depthTest: false,
      depthWrite: false,
    }),
  );
  private readonly closing = new AbortController();

  constructor(
    host: HTMLElement,
    private readonly requestFrame: () => void,
  ) {
    this.sphere.frustumCulled = false;
    this.sphere.renderOrder = -1;
    host.append(this.tones);
    const themed = new MutationObserver(() => this.paint());
    themed.observe(document.documentElement, { attributeFilter: ["data-theme"] });
    const { signal } = this.closing;
    signal.addEventListener("abort", () => themed.disconnect());
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.paint(), {
      signal,
    });
    requestAnimationFrame(() => this.paint()); // in the page by then
  }

  /** Height of the level ground, as it is drawn. */
  set level(z: number) {
    this.uniforms.level.value = z;
  }

  dispose(): void {
    this.closing.abort();
    this.sphere.geometry.dispose();
    this.sphere.material.dispose();
  }

  private paint(): void {
    const { color, backgroundColor, borderTopColor } = getComputedStyle(this.tones);
    if (!color) return; // not in the page
    this.uniforms.horizon.value.set(color);
    this.uniforms.zenith.value.set(backgroundColor);
    this.uniforms.ground.value.set(borderTopColor);
    this.requestFrame();
  }
}
