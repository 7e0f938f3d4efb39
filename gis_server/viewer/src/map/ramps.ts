/**
 * Colour ramps for values that the browser draws: the server's own (`gis_server/rendering/styles.py`), by name.
 *
 * Viridis and inferno rise in lightness and read well without colour vision; red-blue diverges from white and serves
 * differences; twilight is cyclic and serves azimuths.
 */

const list = (colours: string): readonly string[] => colours.split(" ");

export const RAMPS = {
  viridis: list("#440154 #472d7b #3b528b #2c728e #21918c #28ae80 #5ec962 #addc30 #fde725"),
  inferno: list("#000004 #210c4a #57106e #8a226a #bc3754 #e45a31 #f98e09 #f9cb35 #fcffa4"),
  grey: list("#000000 #ffffff"),
  redblue: list("#67001f #b2182b #d6604d #f4a582 #f7f7f7 #92c5de #4393c3 #2166ac #053061"),
  bluered: list("#053061 #2166ac #4393c3 #92c5de #f7f7f7 #f4a582 #d6604d #b2182b #67001f"),
  twilight: list("#e2d9e2 #95b5c7 #6276ba #592a8f #2f1436 #741e4f #b25652 #cca389 #e2d9e2"),
} as const;

export type RampName = keyof typeof RAMPS;

export const RAMP_NAMES = Object.keys(RAMPS) as RampName[];

/** Red, green, blue and opacity of 256 steps along evenly spaced colours `#rrggbb`: 1024 bytes. */
export function lookup(colours: readonly string[]): Uint8ClampedArray {
  const anchors = colours.map(rgb);
  const table = new Uint8ClampedArray(1024);
  const last = anchors.length - 1;
  for (let step = 0; step < 256; step += 1) {
    const at = (step / 255) * last;
    const k = Math.min(Math.floor(at), Math.max(0, last - 1));
    const [from, to] = [anchors[k] ?? [0, 0, 0], anchors[k + 1] ?? anchors[k] ?? [0, 0, 0]];
    for (let channel = 0; channel < 3; channel += 1) {
      const [a, b] = [from[channel] ?? 0, to[channel] ?? 0];
      table[4 * step + channel] = a + (b - a) * (at - k);
    }
    table[4 * step + 3] = 255;
  }
  return table;
}

function rgb(colour: string): readonly number[] {
  return [1, 3, 5].map((at) => Number.parseInt(colour.slice(at, at + 2), 16));
}
