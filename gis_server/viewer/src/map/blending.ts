/** How the colours of a layer are combined with those below it. */

import type BaseLayer from "ol/layer/Base";
import type RenderEvent from "ol/render/Event";

const BLENDS = ["multiply", "screen", "overlay", "darken", "lighten"] as const;
/** Blend modes of a canvas; null: the layer covers those below. */
export type Blend = (typeof BLENDS)[number];
export const BLEND_NAMES: readonly Blend[] = BLENDS;

const KEY = "blend";

/** Draws a layer by the blend that `setBlend` gives it. */
export function blended<T extends BaseLayer>(layer: T): T {
  const operate = (operation: () => GlobalCompositeOperation) => (event: RenderEvent) => {
    const { context } = event;
    if (context instanceof CanvasRenderingContext2D) context.globalCompositeOperation = operation();
  };
  const listening = layer as unknown as {
    on(type: "prerender" | "postrender", listener: (event: RenderEvent) => void): never;
  };
  listening.on(
    "prerender",
    operate(() => (layer.get(KEY) as Blend | null | undefined) ?? "source-over"),
  );
  listening.on(
    "postrender",
    operate(() => "source-over"),
  );
  return layer;
}

export const setBlend = (layer: BaseLayer, blend: Blend | null) => layer.set(KEY, blend);
