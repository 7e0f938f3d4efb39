/** Values at a place: the line below the map follows the pointer, the tab describes the clicked point. */

import { formatChoice } from "../../page/coordinate-format";
import { copyText } from "../../page/copy";
import { h } from "../../page/dom";
import { api } from "../../server/api";
import type { Identified, MapPoint } from "../../server/records";
import type { SceneStops } from "../../server/scene";
import { type Context, identify, openImage } from "../../session/context";
import { coordinateRows, pointPanel } from "./panel";
import { readout } from "./readout";

const HOVER_MS = 120;

export function pointPart(context: Context): void {
  const { page, view, mission, waiting, events, places, frames, coordinates, state } = context;
  const panel = page.addTab("point");
  panel.replaceChildren(...hints(context));

  let shown: { readonly found: Identified; readonly frames: SceneStops } | null = null;
  const actions = {
    openImage: (id: string) => openImage(context, id),
    hoverImage: (id: string | null) => events.imageHovered.emit(id),
    copy: (text: string) => void copyText(page, "Coordinates", text),
  };
  const [about, beside] = [h("div"), h("div")];
  const draw = () => {
    if (!shown) return;
    const rows = coordinateRows(shown.found, coordinates.value, shown.frames);
    panel.replaceChildren(about, beside, pointPanel(shown.found, rows, actions));
  };
  let chosen: MapPoint | null = null;
  const forget = () => {
    [shown, chosen] = [null, null];
    view.setMark(null);
    panel.replaceChildren(...hints(context));
  };
  const query = (point: MapPoint) => {
    view.setMark(point);
    for (const box of [about, beside]) box.replaceChildren();
    events.identified.emit({ point, box: beside });
    const stop = state.get("stop");
    if (stop !== null) events.stop.emit({ stop, point, box: about });
    shown = null;
    chosen = point;
    panel.replaceChildren(about, beside, h("p", { class: "hint", role: "status" }, "Loading…"));
    waiting.run(async () => {
      const answers = [api.identify(mission.mission, point), frames.load()] as const;
      const [found, known] = await Promise.all(answers);
      if (chosen !== point) return;
      shown = { found, frames: known };
      draw();
    });
  };
  page.formatBox.replaceChildren(
    formatChoice(coordinates.value, (format) => coordinates.set(format)),
  );
  coordinates.changed.on(draw);
  state.follow("pt", (point) => (point ? query(point) : forget()));
  places.add({ title: "Identify", run: (point) => identify(context, point) });
  events.click.on(({ point, touched }) => {
    if (typeof touched?.feature.get("image") === "string") return;
    const isStop = touched?.layer.kind === "stops";
    identify(context, point, isStop ? String(touched.feature.get("stop")) : null);
  });
  followPointer(context);
}

function followPointer(context: Context): void {
  const { page, view, layers, mission, waiting, events, coordinates, signal } = context;
  let timer: ReturnType<typeof setTimeout> | undefined;
  let running: AbortController | null = null;
  const heightOf = (id: string) => {
    const layer = view.shown.get(id)?.layer;
    return layer && layers.state(layer).visible ? layers.height(layer) : null;
  };
  const showReadout = (point: MapPoint, found: Identified | null) =>
    page.readout.replaceChildren(
      ...readout(point, view.resolution, view.local, coordinates.value, found, heightOf),
    );
  const stop = () => {
    clearTimeout(timer);
    running?.abort();
  };
  const query = (point: MapPoint) => {
    running = new AbortController();
    api
      .identify(mission.mission, point, running.signal)
      .then((found) => {
        waiting.answered();
        showReadout(point, found);
      })
      .catch((reason: unknown) => waiting.fail(reason));
  };
  events.pointer.on((pointed) => {
    stop();
    if (!pointed) return;
    showReadout(pointed.point, null);
    timer = setTimeout(() => query(pointed.point), HOVER_MS);
  });
  signal.addEventListener("abort", stop);
}

function hints({ mission }: Context): HTMLElement[] {
  const texts = [
    "Click on the map for the value of every layer there and the images that see it. Click a pointing line or footprint to open its image.",
    mission.lsl_note ?? "",
    `Origin: ${mission.landing.name.replace(/^origin: /, "")}, ${mission.landing.source}`,
  ];
  return texts.map((text) => h("p", { class: "hint" }, text));
}
