/** The tab of images: those of a sol or stop, one of them in full, and where on the map it looks. */

import { ImageFeatures } from "../../map/image-features";
import { isIn, type Sols, solsTitle } from "../../map/sols";
import { h } from "../../page/dom";
import { api } from "../../server/api";
import { type ImageEntry, imagesAt, type MapPoint } from "../../server/records";
import { type Context, openImage } from "../../session/context";
import { imageDetail, imageList, stopsOf } from "./panel";

export function imagesPart(context: Context): void {
  const { page, view, layers, waiting, events, mission, state, places } = context;
  const panel = page.addTab("images");
  const [detail, place, list] = [h("div"), h("div"), h("div")];
  const viewing = new ImageFeatures(() => [
    ...layers.widest("footprints"),
    ...layers.widest("pointing"),
  ]);
  let images: readonly ImageEntry[] = [];
  let chosen: string | null = null;
  /** Images that see a place; null: all. */
  let here: ReadonlySet<string> | null = null;

  const drawList = () => {
    const [sols, stop] = [state.get("sol"), state.get("images")];
    const some = images.filter(
      ({ id, ...image }) =>
        (here?.has(id) ?? true) && isIn(image.sol, sols) && (!stop || image.stop === stop),
    );
    const actions = {
      open,
      hover: (id: string | null) => events.imageHovered.emit(id),
    };
    list.replaceChildren(imageList(some, chosen, actions));
  };
  const open = (id: string) => openImage(context, id);
  const draw = () => {
    panel.replaceChildren(detail, filters(context, images), place, list);
    drawList();
  };
  const load = async () => {
    images = await api.images(mission.mission, {});
    draw();
    const image = state.get("image");
    if (image) choose(image.id);
  };
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
  const choose = (id: string) => {
    const image = images.find((entry) => entry.id === id);
    if (!image) return;
    chosen = id;
    const enlarge = ({ browse }: ImageEntry) =>
      page.dialog(id, h("img", { class: "large", src: browse, alt: `image ${id}` }));
    detail.replaceChildren(imageDetail(image, open, enlarge));
    drawList();
    panel.scrollTop = 0;
    showOnMap(null);
  };

  places.add({ title: "Images here", run: showAt });
  layers.replaced.on(() => viewing.forget());
  state.on("image", (image) => {
    if (image && image.id !== chosen) choose(image.id);
  });
  events.imageHovered.on(showOnMap);
  state.on("sol", drawList);
  state.on("images", draw);
  events.click.on(({ touched }) => {
    const image = touched?.feature.get("image");
    if (typeof image === "string") open(image);
  });
  events.pointer.on((pointed) => {
    if (pointed?.touched) view.setHighlight([pointed.touched.feature]);
    else showOnMap(null);
  });
  layers.replaced.on(() => waiting.run(load));
  waiting.run(load);
}

function filters({ layers, state }: Context, images: readonly ImageEntry[]): HTMLElement {
  const days = solsKnown(
    images,
    layers.all.flatMap(({ sols }) => [...sols]),
  );
  /** The slider cannot show a range of several sols. */
  const placeOf = (sols: Sols) => (sols && sols[0] === sols[1] ? days.indexOf(sols[0]) + 1 : 0);
  const name = h("output", {}, solsTitle(state.get("sol")));
  const slider = h("input", {
    type: "range",
    min: 0,
    max: days.length,
    step: 1,
    value: placeOf(state.get("sol")),
    "aria-label": "sol",
    class: "sol",
    oninput: () => {
      const sol = days[Number(slider.value) - 1];
      state.set("sol", sol === undefined ? null : [sol, sol]);
    },
  });
  const forget = state.on("sol", (sols) => {
    if (!slider.isConnected) return forget();
    slider.value = String(placeOf(sols));
    name.textContent = solsTitle(sols);
  });
  const stops = h(
    "select",
    { "aria-label": "stop", onchange: () => state.set("images", stops.value || null) },
    h("option", { value: "" }, "all stops"),
    ...stopsOf(images).map(([id, title]) =>
      h("option", { value: id, selected: id === state.get("images") }, title),
    ),
  );
  return h("div", { class: "filters" }, h("label", { class: "inline" }, name, slider), stops);
}

/** Sols that images or products are of. */
function solsKnown(images: readonly ImageEntry[], ofLayers: readonly number[]): number[] {
  const known = new Set([...images.map(({ sol }) => sol), ...ofLayers]);
  return [...known].sort((a, b) => a - b);
}
