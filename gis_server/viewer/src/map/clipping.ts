/** Draws a layer only on one side of a line across the map. */

import type BaseLayer from "ol/layer/Base";
import type OlMap from "ol/Map";
import { unByKey } from "ol/Observable";
import { getRenderPixel } from "ol/render";
import type RenderEvent from "ol/render/Event";

export type Side = "left" | "right";

/** Corners of the part of a map of this size on one side of a line at a share of its width. */
export function half(
  side: Side,
  [width, height]: readonly [number, number],
  share: number,
): readonly (readonly [number, number])[] {
  const x = share * width;
  const [from, to] = side === "left" ? [0, x] : [x, width];
  return [
    [from, 0],
    [to, 0],
    [to, height],
    [from, height],
  ];
}

/** Clips until the returned function is called; `share` is called at every drawing. */
export function clip(layer: BaseLayer, map: OlMap, side: Side, share: () => number): () => void {
  const before = (event: RenderEvent) => {
    const canvas = event.context;
    const [width = 0, height = 0] = map.getSize() ?? [];
    if (!(canvas instanceof CanvasRenderingContext2D)) return;
    canvas.save();
    canvas.beginPath();
    for (const corner of half(side, [width, height], share())) {
      const [x = 0, y = 0] = getRenderPixel(event, [...corner]);
      canvas.lineTo(x, y);
    }
    canvas.closePath();
    canvas.clip();
  };
  const after = ({ context }: RenderEvent) => {
    if (context instanceof CanvasRenderingContext2D) context.restore();
  };
  const listening = layer as unknown as {
    on(type: "prerender" | "postrender", listener: (event: RenderEvent) => void): never;
  };
  const keys = [listening.on("prerender", before), listening.on("postrender", after)];
  return () => unByKey(keys);
}
