/** Size and scale of a map on paper. */

const INCH_MM = 25.4;
/** Dots of the screen's own size. */
const SCREEN_DPI = 96;
/** Most dots of an image, in width and height, that browsers draw. */
const MOST_PX = 8192;

export const PAPERS = {
  screen: { title: "as on the screen", mm: null },
  a4: { title: "A4, landscape", mm: [277, 180] },
  a3: { title: "A3, landscape", mm: [400, 267] },
} as const;
export type Paper = keyof typeof PAPERS;

export interface Sheet {
  /** Size of the map alone, without the texts below it. */
  readonly width: number;
  readonly height: number;
  /** Metres on the ground a dot. */
  readonly resolution: number;
  readonly dpi: number;
  /** Denominator of the scale on paper. */
  readonly scale: number;
}

/** The sheet of a map of `screen` dots at `resolution`, as it is or at 1 : `scale` on paper. */
export function sheetOf(
  paper: Paper,
  dpi: number,
  scale: number,
  screen: readonly [width: number, height: number],
  resolution: number,
): Sheet {
  const { mm } = PAPERS[paper];
  if (!mm) {
    const perDot = INCH_MM / 1000 / SCREEN_DPI;
    const [width, height] = screen;
    return { width, height, resolution, dpi: SCREEN_DPI, scale: resolution / perDot };
  }
  const [width, height] = mm.map((side) => Math.round((side / INCH_MM) * dpi)) as [number, number];
  if (Math.max(width, height) > MOST_PX)
    throw new Error(
      `an image of ${width} x ${height} dots is more than browsers draw: choose fewer dots per inch`,
    );
  return { width, height, resolution: (scale * INCH_MM) / 1000 / dpi, dpi, scale };
}

/** The round scale next to the one at which the map fits the paper: 1, 2, 2.5 or 5 times a power of ten. */
export function roundScale(scale: number): number {
  const decade = 10 ** Math.floor(Math.log10(scale));
  return ([1, 2, 2.5, 5, 10].find((step) => step * decade >= scale * 0.999) ?? 10) * decade;
}
