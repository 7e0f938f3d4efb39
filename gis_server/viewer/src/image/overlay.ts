/** Drawings over an image: tie points with their residuals, and the place that the cursor marks. */

import { measured, sigmaText } from "../page/format";
import type { ImageTie } from "../server/network";
import type { PixelEllipse, Sight } from "../server/projection";
import { type ImagePoint, type ScreenPoint, toScreen, type Viewport } from "./viewport";

export const TIE_COLOURS: Readonly<Record<string, string>> = {
  "cross-site": "#ffb000",
  "inter-stereo": "#2fe0d0",
  "intra-stereo": "#c9d1da",
};
export const BLUNDER = "#ff4a4a";
const CURSOR = "#ffd400";
const CURVE = "#7cc7ff";
const PICK = "#ff7a1a";
const REACH_PX = 7;

export interface Cross {
  readonly point: ImagePoint;
  readonly ellipse: PixelEllipse | null;
  readonly sight: Sight;
}

export interface Overlay {
  readonly ties: readonly ImageTie[];
  /** Factor of drawn residuals; 0: none are drawn. */
  readonly residualFactor: number;
  readonly cross: Cross | null;
  /** Curve on which a point of another image may lie in this one. */
  readonly curve?: readonly ImagePoint[];
  /** Points that a person picked. */
  readonly picks?: readonly ImagePoint[];
}

export const colourOf = ({ kind, status }: ImageTie): string =>
  status === "blunder" ? BLUNDER : (TIE_COLOURS[kind] ?? "#ffffff");

/** End of a residual vector: from the measured place towards the computed one. */
export function residualEnd(tie: ImageTie, factor: number): ImagePoint | null {
  const { residual_sample_px: sample, residual_line_px: line } = tie;
  if (sample === null || line === null || factor === 0) return null;
  return [tie.sample - factor * sample, tie.line - factor * line];
}

/** The tie point nearest to a screen point, within reach; null where there is none. */
export function tieAt(
  ties: readonly ImageTie[],
  viewport: Viewport,
  [x, y]: ScreenPoint,
): ImageTie | null {
  let [best, least]: [ImageTie | null, number] = [null, REACH_PX];
  for (const tie of ties) {
    const [tx, ty] = toScreen(viewport, [tie.sample, tie.line]);
    const off = Math.hypot(tx - x, ty - y);
    if (off <= least) [best, least] = [tie, off];
  }
  return best;
}

export function drawOverlay(
  paper: CanvasRenderingContext2D,
  viewport: Viewport,
  { ties, residualFactor, cross, curve = [], picks = [] }: Overlay,
): void {
  for (const tie of ties) drawTie(paper, viewport, tie, residualFactor);
  if (curve.length > 1) drawCurve(paper, viewport, curve);
  if (cross) drawCross(paper, viewport, cross);
  for (const pick of picks) drawPick(paper, viewport, pick);
}

function drawCurve(
  paper: CanvasRenderingContext2D,
  viewport: Viewport,
  curve: readonly ImagePoint[],
): void {
  cased(paper, CURVE, 1.2, () => {
    for (const [k, point] of curve.entries()) {
      const [x, y] = toScreen(viewport, point);
      if (k === 0) paper.moveTo(x, y);
      else paper.lineTo(x, y);
    }
  });
}

/** A small open cross: the marked pixel stays visible. */
function drawPick(paper: CanvasRenderingContext2D, viewport: Viewport, pick: ImagePoint): void {
  const [x, y] = toScreen(viewport, pick);
  cased(paper, PICK, 1.6, () => {
    for (const [dx, dy] of [
      [1, 1],
      [1, -1],
      [-1, 1],
      [-1, -1],
    ] as const) {
      paper.moveTo(x + 3 * dx, y + 3 * dy);
      paper.lineTo(x + 11 * dx, y + 11 * dy);
    }
  });
}

/** A dark line below a bright one is seen on any ground. */
function cased(paper: CanvasRenderingContext2D, colour: string, width: number, path: () => void) {
  for (const [stroke, lineWidth] of [
    ["rgba(0,0,0,0.65)", width + 2],
    [colour, width],
  ] as const) {
    paper.strokeStyle = stroke;
    paper.lineWidth = lineWidth;
    paper.beginPath();
    path();
    paper.stroke();
  }
}

function drawTie(
  paper: CanvasRenderingContext2D,
  viewport: Viewport,
  tie: ImageTie,
  factor: number,
): void {
  const [x, y] = toScreen(viewport, [tie.sample, tie.line]);
  const colour = colourOf(tie);
  const end = residualEnd(tie, factor);
  if (end) {
    const [ex, ey] = toScreen(viewport, end);
    cased(paper, colour, 1.4, () => {
      paper.moveTo(x, y);
      paper.lineTo(ex, ey);
    });
  }
  if (tie.status === "blunder")
    cased(paper, colour, 1.8, () => {
      paper.moveTo(x - 4, y - 4);
      paper.lineTo(x + 4, y + 4);
      paper.moveTo(x - 4, y + 4);
      paper.lineTo(x + 4, y - 4);
    });
  else cased(paper, colour, 1.4, () => paper.arc(x, y, 3, 0, 2 * Math.PI));
}

function drawCross(
  paper: CanvasRenderingContext2D,
  viewport: Viewport,
  { point, ellipse, sight }: Cross,
): void {
  const [x, y] = toScreen(viewport, point);
  paper.setLineDash(sight === "visible" ? [] : [4, 4]); // invisible places are dashed, like hidden lines
  cased(paper, CURSOR, 2, () => {
    for (const [dx, dy] of [
      [1, 0],
      [-1, 0],
      [0, 1],
      [0, -1],
    ] as const) {
      paper.moveTo(x + 4 * dx, y + 4 * dy);
      paper.lineTo(x + 18 * dx, y + 18 * dy);
    }
  });
  if (ellipse) {
    const [a, b] = [ellipse.semi_major_px * viewport.scale, ellipse.semi_minor_px * viewport.scale];
    const angle = (ellipse.angle_deg * Math.PI) / 180;
    cased(paper, CURSOR, 1.5, () =>
      paper.ellipse(x, y, Math.max(a, 0.5), Math.max(b, 0.5), angle, 0, 2 * Math.PI),
    );
  }
  paper.setLineDash([]);
}

/** A tie point in words. */
export function tieText(tie: ImageTie): string {
  const { point, kind, status, residual_sample_px: s, residual_line_px: l, sigma_m, pairs } = tie;
  const residual =
    s === null || l === null
      ? "no residual"
      : `residual ${measured(Math.hypot(s, l), "px", null, 0.01)}`;
  const state = status === "used" ? "" : `, ${status === "blunder" ? "set aside" : "not placed"}`;
  const sure = sigma_m === null ? "" : `, known to ${sigmaText(sigma_m)}`;
  const seen = pairs.length > 0 ? `, also in ${pairs.join(", ")}` : ", in this pair alone";
  return `tie point ${point}, ${kind}${state}: ${residual}${sure}${seen}`;
}
