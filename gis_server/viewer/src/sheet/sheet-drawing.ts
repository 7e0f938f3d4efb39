/** A map with its marginal information: title, scale, north, legend, place and credit. */

import { APART_PX, coordinateLabel, ticks } from "../map/frame-ticks";
import { scaleBar } from "../map/scale";
import { compact, unitSign } from "../page/format";
import type { Legend, MapPoint } from "../server/records";
import type { Sheet } from "./sheet";

export interface SheetTexts {
  readonly title: string;
  /** Lines below the title: place, layers, credit. */
  readonly lines: readonly string[];
  readonly legends: readonly (readonly [name: string, legend: Legend])[];
  readonly rotationDeg: number;
  /** East and north of the centre, where grid lines are drawn; null: none. */
  readonly grid: MapPoint | null;
}

/** Sizes at 96 dots an inch; they grow with the density. */
const [MARGIN, STRIP, BAR_MOST, RAMP] = [16, 92, 170, 150];
const SCREEN_DPI = 96;
const INK = "#1e1f22";

/** Height of the texts below the map, dots. */
export const stripHeight = ({ dpi }: Sheet) => Math.round((STRIP * dpi) / SCREEN_DPI);

export function drawSheet(
  map: HTMLCanvasElement,
  sheet: Sheet,
  texts: SheetTexts,
): HTMLCanvasElement {
  const whole = document.createElement("canvas");
  [whole.width, whole.height] = [sheet.width, sheet.height + stripHeight(sheet)];
  const context = whole.getContext("2d");
  if (!context) throw new Error("this browser draws no canvas");
  context.fillStyle = "#ffffff";
  context.fillRect(0, 0, whole.width, whole.height);
  context.drawImage(map, 0, 0);
  const factor = sheet.dpi / SCREEN_DPI;
  context.save();
  context.translate(0, sheet.height);
  context.scale(factor, factor);
  context.fillStyle = INK;
  drawScale(context, sheet, factor);
  drawTexts(context, texts, MARGIN + BAR_MOST + 24, whole.width / factor);
  context.restore();
  if (texts.grid) drawGrid(context, sheet, texts.grid, factor);
  drawNorth(context, sheet.width - 34 * factor, 34 * factor, factor, texts.rotationDeg);
  return whole;
}

const font = (px: number, weight = 400) => `${weight} ${px}px system-ui, sans-serif`;

/** The bar is exactly as long as the ground distance of its label, to the dot. */
function drawScale(context: CanvasRenderingContext2D, sheet: Sheet, factor: number): void {
  const bar = scaleBar(sheet.resolution * factor, BAR_MOST);
  context.fillRect(MARGIN, 30, bar.px, 5);
  context.font = font(12);
  context.textBaseline = "alphabetic";
  context.fillText(bar.label, MARGIN, 22);
  context.font = font(10);
  const density = sheet.dpi === SCREEN_DPI ? "" : ` at ${sheet.dpi} dpi`;
  context.fillText(`1 : ${compact(sheet.scale, 3)}${density}`, MARGIN, 52);
}

function drawTexts(
  context: CanvasRenderingContext2D,
  { title, lines, legends }: SheetTexts,
  left: number,
  width: number,
): void {
  const room = width - MARGIN - left;
  const shown = legends.slice(0, Math.max(0, Math.floor((room - 220) / (RAMP + 24))));
  context.font = font(14, 600);
  context.fillText(title, left, 24, room);
  context.font = font(10);
  const column = room - shown.length * (RAMP + 24);
  lines.forEach((line, k) => context.fillText(line, left, 42 + 14 * k, column));
  shown.forEach(([name, legend], k) =>
    drawLegend(context, width - MARGIN - (shown.length - k) * (RAMP + 24) + 24, name, legend),
  );
}

function drawLegend(
  context: CanvasRenderingContext2D,
  left: number,
  name: string,
  { stops, unit, classes }: Legend,
): void {
  context.font = font(10, 600);
  context.fillStyle = INK;
  context.fillText(unit && !classes?.length ? `${name},${unitSign(unit)}` : name, left, 42, RAMP);
  context.font = font(10);
  if (classes?.length) {
    const step = Math.min(12, 46 / classes.length);
    classes.forEach((one, k) => {
      context.fillStyle = one.colour;
      context.fillRect(left, 47 + step * k, 9, step - 2);
      context.fillStyle = INK;
      context.fillText(one.name, left + 14, 45 + step * (k + 1), RAMP - 14);
    });
    return;
  }
  const [first, last] = [stops[0], stops.at(-1)];
  if (!first || !last) return;
  const gradient = context.createLinearGradient(left, 0, left + RAMP, 0);
  const span = last[0] - first[0] || 1;
  for (const [value, colour] of stops) gradient.addColorStop((value - first[0]) / span, colour);
  context.fillStyle = gradient;
  context.fillRect(left, 48, RAMP, 10);
  context.fillStyle = INK;
  context.textAlign = "left";
  context.fillText(compact(first[0], 3), left, 72);
  context.textAlign = "right";
  context.fillText(compact(last[0], 3), left + RAMP, 72);
  context.textAlign = "left";
}

/** Lines of equal east and north across the map, labelled at its lower and left edges. */
function drawGrid(
  context: CanvasRenderingContext2D,
  { width, height, resolution }: Sheet,
  [east, north]: MapPoint,
  factor: number,
): void {
  context.save();
  context.font = font(10 * factor);
  const label = (text: string, x: number, y: number) => {
    context.fillStyle = "rgba(255,255,255,0.85)";
    context.fillRect(x, y - 12 * factor, context.measureText(text).width + 6 * factor, 15 * factor);
    context.fillStyle = INK;
    context.fillText(text, x + 3 * factor, y);
  };
  context.fillStyle = "rgba(255,255,255,0.45)";
  context.globalCompositeOperation = "difference";
  const easts = ticks(east, resolution, width, APART_PX * factor);
  const norths = ticks(north, -resolution, height, APART_PX * factor);
  for (const { px } of easts) context.fillRect(Math.round(px), 0, factor, height);
  for (const { px } of norths) context.fillRect(0, Math.round(px), width, factor);
  context.globalCompositeOperation = "source-over";
  for (const { px, metres } of easts) label(coordinateLabel(metres, "EW"), px, height - 4 * factor);
  for (const { px, metres } of norths) label(coordinateLabel(metres, "NS"), 0, px - 4 * factor);
  context.restore();
}

function drawNorth(
  context: CanvasRenderingContext2D,
  x: number,
  y: number,
  factor: number,
  rotationDeg: number,
): void {
  context.save();
  context.translate(x, y);
  context.scale(factor, factor);
  context.fillStyle = "rgba(255,255,255,0.9)";
  context.beginPath();
  context.arc(0, 0, 22, 0, 2 * Math.PI);
  context.fill();
  context.rotate((rotationDeg * Math.PI) / 180);
  context.fillStyle = INK;
  context.beginPath();
  for (const [dx, dy] of [
    [0, -6],
    [7, 14],
    [0, 9],
    [-7, 14],
  ] as const)
    context.lineTo(dx, dy);
  context.fill();
  context.font = font(11, 700);
  context.textAlign = "center";
  context.fillText("N", 0, -9);
  context.restore();
}
