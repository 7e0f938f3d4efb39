/** The map at one range of sols after the other, as frames with title, scale and legends. */

import { type Sols, solsTitle } from "../../../map/sols";
import type { Context } from "../../../session/context";
import { textsOf } from "../../../sheet/texts";
import { sheetOf } from "../../../sheet/sheet";
import { drawSheet } from "../../../sheet/sheet-drawing";
import { snapshot } from "../../../sheet/snapshot";

/** Larger frames are made smaller. */
const MOST_PX = 1280;
/** Encoders of video take whole blocks of this many pixels. */
const BLOCK_PX = 2;

const whole = (px: number) => BLOCK_PX * Math.round(px / BLOCK_PX);

/** Shows the sols of every step until it is drawn completely; restores the earlier sols at the end. */
export async function* framesOf(
  context: Context,
  steps: readonly Sols[],
  credit: string,
): AsyncGenerator<HTMLCanvasElement> {
  const { view, mission, state, waiting } = context;
  const before = state.get("sol");
  try {
    for (const step of steps) {
      state.set("sol", step);
      await waiting.settled();
      const [width = 1, height = 1] = view.map.getSize() ?? [];
      const sheet = sheetOf("screen", 96, 1, [width, height], view.resolution);
      const title = `${mission.title}, ${solsTitle(step)}`;
      const map = await snapshot(view, sheet);
      yield fitted(drawSheet(map, sheet, textsOf(context, { title, credit })));
    }
  } finally {
    state.set("sol", before);
  }
}

function fitted(canvas: HTMLCanvasElement): HTMLCanvasElement {
  const scale = Math.min(1, MOST_PX / Math.max(canvas.width, canvas.height));
  const frame = document.createElement("canvas");
  [frame.width, frame.height] = [whole(canvas.width * scale), whole(canvas.height * scale)];
  const context = frame.getContext("2d");
  if (!context) throw new Error("this browser draws no canvas");
  context.drawImage(canvas, 0, 0, frame.width, frame.height);
  return frame;
}
