/** Both images of a pair as one anaglyph: left red, right cyan, shifted by some pixels. */

async function pixels(url: string): Promise<ImageData> {
  const image = new Image();
  image.src = url;
  await image.decode();
  const canvas = new OffscreenCanvas(image.naturalWidth, image.naturalHeight);
  const paper = canvas.getContext("2d", { willReadFrequently: true });
  paper?.drawImage(image, 0, 0);
  return (paper ?? raise()).getImageData(0, 0, canvas.width, canvas.height);
}

const raise = (): never => {
  throw new Error("this browser has no canvas to draw on");
};

/** Grey of the right image is drawn `nudge` pixels to the right; where there is none, cyan stays dark. */
export function fused(
  left: Uint8ClampedArray,
  right: Uint8ClampedArray,
  width: number,
  nudge: number,
): Uint8ClampedArray<ArrayBuffer> {
  const both = new Uint8ClampedArray(left.length);
  for (let at = 0; at < left.length; at += 4) {
    const column = ((at / 4) % width) - nudge;
    const other = column >= 0 && column < width ? (right[at - 4 * nudge] ?? 0) : 0;
    both[at] = left[at] ?? 0;
    both[at + 1] = other;
    both[at + 2] = other;
    both[at + 3] = 255;
  }
  return both;
}

/** URL of the anaglyph; its pixels are those of the left image. */
export async function anaglyphUrl(left: string, right: string, nudge: number): Promise<string> {
  const [one, other] = await Promise.all([pixels(left), pixels(right)]);
  const canvas = new OffscreenCanvas(one.width, one.height);
  const both = new ImageData(fused(one.data, other.data, one.width, nudge), one.width, one.height);
  canvas.getContext("2d")?.putImageData(both, 0, 0);
  return URL.createObjectURL(await canvas.convertToBlob());
}
