/** All downloads: files, parts of them, URLs, and the map as an image. */

import { Sketch } from "../../map/sketch";
import { copyText } from "../../page/copy";
import { saveFile } from "../../page/save";
import { downloads } from "../../server/downloads";
import type { Bounds, MapPoint } from "../../server/records";
import type { Context } from "../../session/context";
import "./downloads.css";
import { FilesPanel } from "./panel";
import { pdfOf } from "./pdf";
import { imageSettings, type ImageFormat, type ImageSettings } from "./image-settings";
import { withDensity } from "./png";
import { drawSheet } from "../../sheet/sheet-drawing";
import { roundScale, sheetOf } from "../../sheet/sheet";
import { snapshot } from "../../sheet/snapshot";
import { CREDIT, textsOf } from "../../sheet/texts";

const JPEG_QUALITY = 0.95;

export function downloadsPart(context: Context): void {
  const { page, layers, view, mission, waiting, keys, signal } = context;
  const tab = page.addTab("downloads");
  let sketch: Sketch | null = null;

  const stop = () => {
    sketch?.stop();
    sketch = null;
  };
  const drawBox = () => {
    stop();
    sketch = new Sketch(view, "box", {
      end: (corners) => {
        files.show({ box: boundsOf(corners) });
        stop();
      },
    });
  };
  const copy = (text: string) => void copyText(page, "Address", text);
  const files = new FilesPanel({ drawBox, copy });
  /** Each list loads by itself: a failed one shows its error, the others are complete. */
  const load = () => {
    isLoaded = true;
    const { mission: name } = mission;
    waiting.run(async () => files.show({ collections: await downloads.collections(name) }));
    const terrains = layers.of("dtm").filter(({ level }) => level === "stop");
    waiting.run(async () => files.show({ models: await downloads.models(name), terrains }));
    waiting.run(async () => files.show({ addresses: await downloads.addresses(name) }));
  };
  const saveMap = (settings: ImageSettings, format: ImageFormat) =>
    waiting.run(() => saveImage(context, settings, format));
  let isOpen = false;
  let isLoaded = false;
  // The content is fetched only when the tab is opened.
  new IntersectionObserver((entries) => {
    isOpen = entries.some(({ isIntersecting }) => isIntersecting);
    if (isOpen && !isLoaded) load();
  }).observe(files.element);
  layers.changed.on(() => files.show({ shown: layers.shown }));
  layers.rearranged.on(() => files.show({ shown: layers.shown }));
  layers.replaced.on(() => {
    isLoaded = false;
    files.show({ shown: layers.shown });
    if (isOpen) load();
  });
  keys.add("Escape", "stop drawing a box", stop);
  signal.addEventListener("abort", stop);
  tab.replaceChildren(imageSettings(firstSettings(context), saveMap), files.element);
  files.show({ shown: layers.shown });
}

function boundsOf(corners: readonly MapPoint[]): Bounds {
  const [easts, norths] = [corners.map(([east]) => east), corners.map(([, north]) => north)];
  return [Math.min(...easts), Math.min(...norths), Math.max(...easts), Math.max(...norths)];
}

function firstSettings({ mission, view }: Context): ImageSettings {
  const { scale } = sheetOf("screen", 96, 1, [1, 1], view.resolution);
  return {
    paper: "screen",
    dpi: 200,
    scale: roundScale(scale),
    title: mission.title,
    credit: CREDIT,
  };
}

async function saveImage(
  context: Context,
  settings: ImageSettings,
  format: ImageFormat,
): Promise<void> {
  const { view, mission, waiting } = context;
  const [width = 1, height = 1] = view.map.getSize() ?? [];
  try {
    const sheet = sheetOf(
      settings.paper,
      settings.dpi,
      settings.scale,
      [width, height],
      view.resolution,
    );
    const map = await snapshot(view, sheet);
    const whole = drawSheet(map, sheet, textsOf(context, settings));
    const name = `${mission.mission}_map.${format}`;
    if (format === "png") {
      const png = await encoded(whole, "image/png");
      saveFile(name, "image/png", withDensity(png, sheet.dpi));
    } else {
      const jpeg = await encoded(whole, "image/jpeg");
      saveFile(name, "application/pdf", pdfOf(jpeg, [whole.width, whole.height], sheet.dpi));
    }
  } catch (reason) {
    waiting.notify(reason instanceof Error ? reason.message : String(reason));
  }
}

async function encoded(canvas: HTMLCanvasElement, type: string): Promise<Uint8Array> {
  const blob = await new Promise<Blob | null>((done) => canvas.toBlob(done, type, JPEG_QUALITY));
  if (!blob) throw new Error("the browser could not make the image: choose a smaller one");
  return new Uint8Array(await blob.arrayBuffer());
}
