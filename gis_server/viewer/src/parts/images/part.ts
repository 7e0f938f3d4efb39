/** The tab of images: those of a sol or stop, one of them in full, and where on the map it looks. */

import { ImageFeatures } from "../../map/image-features";
import { isIn, type Sols, solsTitle } from "../../map/sols";
import { h } from "../../page/dom";
import { api } from "../../server/api";
import { type ImageEntry, imagesAt, type MapPoint } from "../../server/records";
import type { Context } from "../../session/context";
import { imageDetail, imageList, stopsOf } from "./panel";

export function imagesPart(context: Context): void {
  const { page, view, layers, waiting, signals, mission, drawing, places } = context;
  const panel = page.addTab("images", "Images");
  const [detail, place, list] = [h("div"), h("div"), h("div")];
  const viewing = new ImageFeatures(() => [
    ...layers.widest("footprints"),
    ...layers.widest("pointing"),
  ]);
  let images: readonly ImageEntry[] = [];
  let stop: string | null = null;
  let chosen: string | null = null;
  /** Images that see a place; null: all. */
  let here: ReadonlySet<string> | null = null;

  const drawList = () => {
    const { sols } = drawing;
    const some = images.filter(
      ({ id, ...image }) =>
        (here?.has(id) ?? true) && isIn(image.sol, sols) && (!stop || image.stop === stop),
    );
    const actions = {
      open: (id: string) => signals.image.emit(id),
      hover: (id: string | null) => signals.imageHovered.emit(id),
    };
    list.replaceChildren(imageList(some, chosen, actions));
  };
  const setStop = (id: string | null) => {
    stop = id;
    drawList();
  };
  const draw = () => {
    panel.replaceChildren(detail, filters(context, images, stop, setStop), place, list);
    drawList();
  };
  const load = async () => {
    images = await api.images(mission.mission, {});
    draw();
  };
  signals.imagesOf.on((id) => {
    stop = id;
    draw();
    page.showTab("images");
  });
  const showOnMap = (id: string | null) => {
    const shown = id ?? chosen;
    if (shown === null) view.setHighlight([]);
    else waiting.run(async () => view.setHighlight(await viewing.of(shown)));
  };
  const everywhere = () => {
    here = null;
    view.setMark(null);
    place.replaceChildren();
    drawList();
  };
  const showAt = (point: MapPoint) => {
    page.showTab("images");
    waiting.run(async () => {
      here = new Set(imagesAt(await api.identify(mission.mission, point)));
      view.setMark(point);
      const all = h("button", { type: "button", class: "text", onclick: everywhere }, "show all");
      place.replaceChildren(h("p", { class: "hint at-place" }, "Images that see the place. ", all));
      drawList();
    });
  };
  const open = (id: string) => {
    const image = images.find((entry) => entry.id === id);
    if (!image) {
      waiting.say(`the server lists no image ${id}`);
      return;
    }
    chosen = id;
    const enlarge = ({ browse }: ImageEntry) =>
      page.dialog(id, h("img", { class: "large", src: browse, alt: `image ${id}` }));
    detail.replaceChildren(imageDetail(image, (other) => signals.image.emit(other), enlarge));
    drawList();
    page.showTab("images");
    panel.scrollTop = 0;
    showOnMap(null);
  };

  places.add({ title: "Images here", run: showAt });
  layers.replaced.on(() => viewing.forget());
  signals.image.on(open);
  signals.imageHovered.on(showOnMap);
  signals.sols.on(drawList);
  signals.click.on(({ touched }) => {
    const image = touched?.feature.get("image");
    if (typeof image === "string") signals.image.emit(image);
  });
  signals.pointer.on((pointed) => {
    if (pointed?.touched) view.setHighlight([pointed.touched.feature]);
    else showOnMap(null);
  });
  layers.replaced.on(() => waiting.run(load));
  waiting.run(load);
}

function filters(
  { layers, drawing, signals }: Context,
  images: readonly ImageEntry[],
  stop: string | null,
  setStop: (id: string | null) => void,
): HTMLElement {
  const days = solsKnown(
    images,
    layers.all.flatMap(({ sols }) => [...sols]),
  );
  /** The slider cannot show a range of several sols. */
  const placeOf = (sols: Sols) => (sols && sols[0] === sols[1] ? days.indexOf(sols[0]) + 1 : 0);
  const name = h("output", {}, solsTitle(drawing.sols));
  const slider = h("input", {
    type: "range",
    min: 0,
    max: days.length,
    step: 1,
    value: placeOf(drawing.sols),
    "aria-label": "sol",
    class: "sol",
    oninput: () => {
      const sol = days[Number(slider.value) - 1];
      signals.sols.emit(sol === undefined ? null : [sol, sol]);
    },
  });
  const forget = signals.sols.on((sols) => {
    if (!slider.isConnected) return forget();
    slider.value = String(placeOf(sols));
    name.textContent = solsTitle(sols);
  });
  const stops = h(
    "select",
    { "aria-label": "stop", onchange: () => setStop(stops.value || null) },
    h("option", { value: "" }, "all stops"),
    ...stopsOf(images).map(([id, title]) =>
      h("option", { value: id, selected: id === stop }, title),
    ),
  );
  return h("div", { class: "filters" }, h("label", { class: "inline" }, name, slider), stops);
}

/** Sols that images or products are of. */
function solsKnown(images: readonly ImageEntry[], ofLayers: readonly number[]): number[] {
  const known = new Set([...images.map(({ sol }) => sol), ...ofLayers]);
  return [...known].sort((a, b) => a - b);
}
