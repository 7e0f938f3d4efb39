/**
 * A map that is drawn less often while nothing moves. Every tile and feature that arrives requests a new frame, and a
 * frame draws the whole canvas: the first view of three stops took forty of them, half of the time of the page.
 */

import OlMap from "ol/Map";
import type View from "ol/View";

/** Least time between two frames while only data arrives, milliseconds. */
const REST_MS = 60;
/** Tiles requested at a time: as many as arrive between two frames. */
export const TILES_ON_THEIR_WAY = 32;

export class ThrottledMap extends OlMap {
  private lastMs = 0;
  private timer: ReturnType<typeof setTimeout> | undefined;

  /** Draws in the next frame while the view moves; else when the last frame is some time ago. */
  override render(): void {
    if (this.timer !== undefined && !this.isMoving) return;
    const wait = this.isMoving ? 0 : this.lastMs + REST_MS - performance.now();
    if (wait > 0) this.timer = setTimeout(() => this.draw(), wait);
    else this.draw();
  }

  private draw(): void {
    clearTimeout(this.timer);
    this.timer = undefined;
    this.lastMs = performance.now();
    super.render();
  }

  private get isMoving(): boolean {
    const view: View | undefined = this.getView(); // none yet while the map is being made
    return Boolean(view?.getAnimating() || view?.getInteracting());
  }

  protected override disposeInternal(): void {
    clearTimeout(this.timer);
    super.disposeInternal();
  }
}
