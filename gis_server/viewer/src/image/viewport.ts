/**
 * The part of an image on the screen.
 *
 * Image points are (sample, line), (0, 0) being the centre of the first pixel; screen points are in CSS pixels from the
 * upper left corner of the view, which is where the corner (-0.5, -0.5) of the image lies when nothing is shifted.
 */

export type ImagePoint = readonly [sample: number, line: number];
export type ScreenPoint = readonly [x: number, y: number];
export type Size = readonly [width: number, height: number];

export interface Viewport {
  /** Screen pixels per image pixel. */
  readonly scale: number;
  /** Screen point of the image's upper left corner. */
  readonly left: number;
  readonly top: number;
}

export const LARGEST_SCALE = 64;
/** The smallest scale shows the image at this share of the size that fits. */
const SMALLEST_SHARE = 0.5;

export const toScreen = ({ scale, left, top }: Viewport, [s, l]: ImagePoint): ScreenPoint => [
  left + (s + 0.5) * scale,
  top + (l + 0.5) * scale,
];

export const toImage = ({ scale, left, top }: Viewport, [x, y]: ScreenPoint): ImagePoint => [
  (x - left) / scale - 0.5,
  (y - top) / scale - 0.5,
];

/** The whole image, in the middle of the view. */
export function fitted([samples, lines]: Size, [width, height]: Size): Viewport {
  const scale = Math.min(width / samples, height / lines);
  return { scale, left: (width - samples * scale) / 2, top: (height - lines * scale) / 2 };
}

/** Zooms about a point of the screen, which stays where it is. */
export function zoomed(
  viewport: Viewport,
  factor: number,
  [x, y]: ScreenPoint,
  image: Size,
  view: Size,
): Viewport {
  const least = fitted(image, view).scale * SMALLEST_SHARE;
  const scale = Math.min(LARGEST_SCALE, Math.max(least, viewport.scale * factor));
  const grown = scale / viewport.scale;
  const moved = {
    scale,
    left: x - (x - viewport.left) * grown,
    top: y - (y - viewport.top) * grown,
  };
  return held(moved, image, view);
}

export function panned(
  viewport: Viewport,
  dx: number,
  dy: number,
  image: Size,
  view: Size,
): Viewport {
  return held({ ...viewport, left: viewport.left + dx, top: viewport.top + dy }, image, view);
}

/** Changes the size of the view and keeps its middle. */
export function refitted(viewport: Viewport, before: Size, image: Size, view: Size): Viewport {
  return panned(viewport, (view[0] - before[0]) / 2, (view[1] - before[1]) / 2, image, view);
}

/** A point of the image in the middle of the view, at a scale. */
export function centred(
  [sample, line]: ImagePoint,
  scale: number,
  image: Size,
  view: Size,
): Viewport {
  const left = view[0] / 2 - (sample + 0.5) * scale;
  const top = view[1] / 2 - (line + 0.5) * scale;
  return held({ scale, left, top }, image, view);
}

/** The middle of the view stays over the image. */
function held({ scale, left, top }: Viewport, [samples, lines]: Size, [width, height]: Size) {
  const within = (start: number, length: number, room: number) =>
    Math.min(room / 2, Math.max(room / 2 - length * scale, start));
  return { scale, left: within(left, samples, width), top: within(top, lines, height) };
}

export const isInside = ([sample, line]: ImagePoint, [samples, lines]: Size): boolean =>
  sample >= -0.5 && line >= -0.5 && sample <= samples - 0.5 && line <= lines - 0.5;
