/** Drawing of a stereo pair on a canvas: red and cyan, side by side, or one after the other. */

import type { PairImages } from "../../server/stereo";
import type { StereoSight } from "../../session/state";
import { bestParallax, type Grey, type Sight } from "./fuse";

export type Way = StereoSight["way"];

/** Pixels of the left and the right image that are marked. */
export type Crosses = readonly [
  left: readonly [number, number] | null,
  right: readonly [number, number] | null,
];

/** State of the drawing: the shift of the right image, the eye shown when they alternate, the marks. */
export interface Drawn {
  readonly nudge: number;
  readonly phase: 0 | 1;
  readonly crosses: Crosses;
}

const RED = "#ff0000";
const CYAN = "#00ffff";
const MARK = "#ffd400";
const ARM_PX = 14;
/** Images are compared at this width; their parallax is at most that share of it. */
const COARSE_PX = 128;
const MOST = 0.45;
/** Rows that are compared: the sky has no texture. */
const [TOP, BOTTOM] = [0.3, 0.95];

function pen(canvas: HTMLCanvasElement): CanvasRenderingContext2D {
  const context = canvas.getContext("2d", { willReadFrequently: false });
  if (!context) throw new Error("this browser cannot draw images on a canvas");
  return context;
}

function canvasOf(width: number, height: number): HTMLCanvasElement {
  const canvas = document.createElement("canvas");
  [canvas.width, canvas.height] = [width, height];
  return canvas;
}

function tinted(image: ImageBitmap, colour: string): HTMLCanvasElement {
  const canvas = canvasOf(image.width, image.height);
  const context = pen(canvas);
  context.drawImage(image, 0, 0);
  context.globalCompositeOperation = "multiply";
  context.fillStyle = colour;
  context.fillRect(0, 0, canvas.width, canvas.height);
  return canvas;
}

function coarse(image: ImageBitmap): Grey {
  const [top, bottom] = [TOP * image.height, BOTTOM * image.height];
  const width = Math.min(COARSE_PX, image.width);
  const height = Math.max(1, Math.round(((bottom - top) * width) / image.width));
  const context = pen(canvasOf(width, height));
  context.drawImage(image, 0, top, image.width, bottom - top, 0, 0, width, height);
  const { data } = context.getImageData(0, 0, width, height);
  return { width, height, values: data.filter((_, k) => k % 4 === 1) };
}

/** A cross at a pixel of an image whose corner is given. */
function cross(
  context: CanvasRenderingContext2D,
  left: number,
  top: number,
  [sample, line]: readonly [number, number],
  scale: number,
  colour: string,
): void {
  const [x, y] = [left + (sample + 0.5) * scale, top + (line + 0.5) * scale];
  const arms = new Path2D(`M${x - ARM_PX} ${y}h${2 * ARM_PX}M${x} ${y - ARM_PX}v${2 * ARM_PX}`);
  context.strokeStyle = colour;
  context.lineWidth = 3;
  context.stroke(arms);
}

export class StereoDisplay {
  readonly width: number;
  readonly height: number;
  readonly isLinearised: boolean;
  /** The parallax of most of the image, in its pixels. */
  readonly parallax: number;
  private readonly red: HTMLCanvasElement;
  private readonly cyan: HTMLCanvasElement;

  constructor(private readonly images: PairImages) {
    const { left, right, isLinearised } = images;
    [this.width, this.height] = [left.width, left.height];
    this.isLinearised = isLinearised;
    const [a, b] = [coarse(left), coarse(right)];
    const found = bestParallax(a, b, Math.round(MOST * a.width));
    this.parallax = Math.round((found * left.width) / a.width);
    this.red = tinted(left, RED);
    this.cyan = tinted(right, CYAN);
  }

  draw(canvas: HTMLCanvasElement, way: Way, sight: Sight, drawn: Drawn): void {
    const { nudge, phase, crosses } = drawn;
    const context = pen(canvas);
    const { width, height } = canvas;
    context.globalCompositeOperation = "source-over";
    context.fillStyle = "#000";
    context.fillRect(0, 0, width, height);
    context.imageSmoothingEnabled = sight.scale < 2;
    const { left, right } = this.images;
    const put = (image: CanvasImageSource, middle: number, eye: 0 | 1, colour: string) => {
      const x = middle + ((eye ? nudge : 0) - sight.x) * sight.scale;
      const y = height / 2 - sight.y * sight.scale;
      context.drawImage(image, x, y, this.width * sight.scale, this.height * sight.scale);
      const mark = crosses[eye];
      if (mark) cross(context, x, y, mark, sight.scale, colour);
    };
    switch (way) {
      case "anaglyph":
        put(this.red, width / 2, 0, RED);
        context.globalCompositeOperation = "lighter";
        put(this.cyan, width / 2, 1, CYAN);
        return;
      case "wiggle":
        put(phase ? right : left, width / 2, phase, MARK);
        return;
      case "parallel":
      case "crossed": {
        const [first, second] = way === "parallel" ? [left, right] : [right, left];
        [first, second].forEach((image, half) => {
          context.save();
          context.beginPath();
          context.rect((half * width) / 2, 0, width / 2, height);
          context.clip();
          put(image, ((2 * half + 1) * width) / 4, image === right ? 1 : 0, MARK);
          context.restore();
        });
        return;
      }
      default:
        throw new Error(`unknown way ${JSON.stringify(way satisfies never)}`);
    }
  }

  dispose(): void {
    this.images.left.close();
    this.images.right.close();
  }
}
