/** The map as one image, at the size and scale of a sheet. */

import type { MapView } from "../map/map-view";
import type { Sheet } from "./sheet";

/** Draws the map at the sheet's size, copies it, and puts it back as it was. */
export async function snapshot(view: MapView, sheet: Sheet): Promise<HTMLCanvasElement> {
  const { map } = view;
  const size = map.getSize() ?? [sheet.width, sheet.height];
  const { resolution } = view;
  const isChanged =
    sheet.resolution !== resolution || size[0] !== sheet.width || size[1] !== sheet.height;
  try {
    if (isChanged) {
      map.setSize([sheet.width, sheet.height]);
      view.view.setResolution(sheet.resolution);
    }
    await drawn(view);
    const target = map.getTargetElement();
    if (!target) throw new Error("the map is on no page");
    return compose(target, sheet);
  } finally {
    if (isChanged) {
      map.setSize(size);
      view.view.setResolution(resolution);
    }
  }
}

function drawn({ map }: MapView): Promise<void> {
  return new Promise((resolve) => {
    map.once("rendercomplete", () => resolve());
    map.render();
  });
}

/** All canvases of the map, one over the other, as the browser lays them. */
function compose(target: HTMLElement, { width, height }: Sheet): HTMLCanvasElement {
  const whole = document.createElement("canvas");
  [whole.width, whole.height] = [width, height];
  const context = whole.getContext("2d");
  if (!context) throw new Error("this browser draws no canvas");
  context.fillStyle = "#ffffff";
  context.fillRect(0, 0, width, height);
  const layers = target.querySelectorAll<HTMLCanvasElement>(".ol-layer canvas, canvas.ol-layer");
  for (const canvas of layers) {
    if (canvas.width === 0) continue;
    const opacity = canvas.parentElement?.style.opacity || canvas.style.opacity;
    context.globalAlpha = opacity === "" ? 1 : Number(opacity);
    const numbers = /^matrix\(([^)]*)\)$/.exec(canvas.style.transform)?.[1]?.split(",").map(Number);
    const [a = 1, b = 0, c = 0, d = 1, e = 0, f = 0] = numbers ?? [
      Number.parseFloat(canvas.style.width) / canvas.width || 1,
      0,
      0,
      Number.parseFloat(canvas.style.height) / canvas.height || 1,
    ];
    context.setTransform(a, b, c, d, e, f);
    context.drawImage(canvas, 0, 0);
  }
  return whole;
}
