/** Frames one after the other as one file: a video by the browser's own encoder (WebCodecs), or a GIF. */

import {
  BufferTarget,
  CanvasSource,
  getFirstEncodableVideoCodec,
  Output,
  QUALITY_HIGH,
  type VideoCodec,
  WebMOutputFormat,
} from "mediabunny";
import { applyPalette, GIFEncoder, quantize } from "gifenc";

type Frames = AsyncIterable<HTMLCanvasElement>;

export interface Encoder {
  readonly title: string;
  readonly ending: string;
  readonly type: string;
  /** Duration of each frame, seconds. */
  readonly encode: (frames: Frames, hold_s: number) => Promise<Uint8Array<ArrayBuffer>>;
}

const CODECS: VideoCodec[] = ["vp9", "vp8", "av1"];

async function video(frames: Frames, hold_s: number): Promise<Uint8Array<ArrayBuffer>> {
  const canvas = document.createElement("canvas");
  const target = new BufferTarget();
  const output = new Output({ format: new WebMOutputFormat(), target });
  let source: CanvasSource | null = null;
  let count = 0;
  for await (const frame of frames) {
    if (!source) {
      [canvas.width, canvas.height] = [frame.width, frame.height];
      const codec = await getFirstEncodableVideoCodec(CODECS, { ...sizeOf(frame) });
      if (!codec) throw new Error("the browser encodes no video of this size: save a GIF");
      source = new CanvasSource(canvas, { codec, bitrate: QUALITY_HIGH });
      output.addVideoTrack(source);
      await output.start();
    }
    canvas.getContext("2d")?.drawImage(frame, 0, 0, canvas.width, canvas.height);
    await source.add(hold_s * count++, hold_s);
  }
  await output.finalize();
  if (!target.buffer) throw new Error("the video could not be written: save a GIF");
  return new Uint8Array(target.buffer);
}

const sizeOf = ({ width, height }: HTMLCanvasElement) => ({ width, height });

async function gif(frames: Frames, hold_s: number): Promise<Uint8Array<ArrayBuffer>> {
  const encoder = GIFEncoder();
  for await (const frame of frames) {
    const { width, height } = frame;
    const pixels = frame.getContext("2d")?.getImageData(0, 0, width, height).data;
    if (!pixels) throw new Error("this browser draws no canvas");
    const palette = quantize(pixels, 256);
    encoder.writeFrame(applyPalette(pixels, palette), width, height, {
      palette,
      delay: 1000 * hold_s,
    });
  }
  encoder.finish();
  return encoder.bytes();
}

const WEBM = { title: "video (WebM)", ending: "webm", type: "video/webm", encode: video };
const GIF = { title: "GIF", ending: "gif", type: "image/gif", encode: gif };

/** The encoders of the browser, which encodes video only on https or localhost pages. */
export const encoders = (): readonly Encoder[] => ("VideoEncoder" in window ? [WEBM, GIF] : [GIF]);
