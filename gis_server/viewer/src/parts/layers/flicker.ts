/** Shows and hides a layer in turn, so that differences from the layers below become visible. */

import type { Layer } from "../../server/records";

/** Slower than three flashes a second, which is where flashing does harm. */
const EVERY_MS = 600;

export class Flicker {
  private timer: ReturnType<typeof setInterval> | undefined;
  private of: string | null = null;

  constructor(private readonly draw: (layer: Layer, visible: boolean) => void) {}

  get layer(): string | null {
    return this.of;
  }

  toggle(layer: Layer): void {
    const wasOn = this.of === layer.id;
    this.stop();
    if (wasOn) return;
    this.of = layer.id;
    let visible = true;
    this.timer = setInterval(() => {
      visible = !visible;
      this.draw(layer, visible);
    }, EVERY_MS);
  }

  stop(): void {
    clearInterval(this.timer);
    this.of = null;
  }
}
