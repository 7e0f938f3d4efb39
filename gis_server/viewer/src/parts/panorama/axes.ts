/** The axes of a panorama, drawn over it: azimuths along the lower edge, elevations along the left, the horizon. */

import { fixed } from "../../page/format";
import { type AngleGrid, azimuthLabel, directionAt, marks, stepFor } from "./angles";

const LEAST_X_PX = 80;
const LEAST_Y_PX = 36;
const TICK_PX = 7;
const FONT = "11px system-ui, sans-serif";

export interface Shown {
  /** Upper left corner of the screen, in the plane of the panorama. */
  readonly left: number;
  readonly top: number;
  /** Columns a screen pixel. */
  readonly resolution: number;
}

export function drawAxes(canvas: HTMLCanvasElement, grid: AngleGrid, shown: Shown): void {
  const { clientWidth: width, clientHeight: height } = canvas;
  const ratio = devicePixelRatio;
  canvas.width = Math.round(width * ratio);
  canvas.height = Math.round(height * ratio);
  const pen = canvas.getContext("2d");
  if (!pen || width === 0) return;
  pen.scale(ratio, ratio);
  pen.font = FONT;
  pen.lineWidth = 1;
  const perPixel = grid.cell_deg * shown.resolution;
  const west = grid.west_deg + shown.left * grid.cell_deg;
  const [, top] = directionAt(grid, [0, shown.top]);
  horizon(pen, top / perPixel, width);
  const across = stepFor(perPixel, LEAST_X_PX);
  for (const azimuth of marks(west, west + width * perPixel, across)) {
    const x = (azimuth - west) / perPixel;
    tick(pen, x, height, x, height - TICK_PX);
    text(pen, azimuthLabel(azimuth, across), x, height - TICK_PX - 4, "center");
  }
  const down = stepFor(perPixel, LEAST_Y_PX);
  for (const elevation of marks(Math.max(-90, top - height * perPixel), Math.min(90, top), down)) {
    const y = (top - elevation) / perPixel;
    if (y > height - 30) continue; // room for azimuths
    tick(pen, 0, y, TICK_PX, y);
    text(pen, `${fixed(elevation, down < 1 ? 1 : 0)}\u00b0`, TICK_PX + 4, y + 4, "left");
  }
}

/** The level through the panorama's own height. */
function horizon(pen: CanvasRenderingContext2D, y: number, width: number): void {
  pen.setLineDash([6, 5]);
  pen.strokeStyle = "rgba(255, 212, 0, 0.75)";
  pen.beginPath();
  pen.moveTo(0, y);
  pen.lineTo(width, y);
  pen.stroke();
  pen.setLineDash([]);
}

function tick(pen: CanvasRenderingContext2D, x: number, y: number, toX: number, toY: number) {
  for (const [colour, wide] of [
    ["rgba(0, 0, 0, 0.7)", 3],
    ["#ffffff", 1],
  ] as const) {
    pen.strokeStyle = colour;
    pen.lineWidth = wide;
    pen.beginPath();
    pen.moveTo(x, y);
    pen.lineTo(toX, toY);
    pen.stroke();
  }
}

function text(
  pen: CanvasRenderingContext2D,
  words: string,
  x: number,
  y: number,
  align: CanvasTextAlign,
): void {
  pen.textAlign = align;
  pen.strokeStyle = "rgba(0, 0, 0, 0.8)";
  pen.lineWidth = 3;
  pen.strokeText(words, x, y);
  pen.fillStyle = "#ffffff";
  pen.fillText(words, x, y);
}
