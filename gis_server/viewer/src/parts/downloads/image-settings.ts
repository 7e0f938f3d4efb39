/** Settings of the map's image: its size and scale, its title and credit. */

import { h } from "../../page/dom";
import { type Paper, PAPERS } from "../../sheet/sheet";

export type ImageFormat = "png" | "pdf";

export interface ImageSettings {
  readonly paper: Paper;
  readonly dpi: number;
  readonly scale: number;
  readonly title: string;
  readonly credit: string;
}

/** `first` are the initial settings. */
export function imageSettings(
  first: ImageSettings,
  take: (settings: ImageSettings, format: ImageFormat) => void,
): HTMLElement {
  const input = (name: string, value: string | number, type = "text") =>
    h("input", {
      type,
      value,
      "aria-label": name,
      class: type === "number" ? "compact-number" : "wide",
    });
  const paper = h(
    "select",
    { "aria-label": "paper", onchange: () => show() },
    ...Object.entries(PAPERS).map(([key, { title }]) => h("option", { value: key }, title)),
  );
  const [dpi, scale] = [
    input("dots an inch", first.dpi, "number"),
    input("scale, 1 to", first.scale, "number"),
  ];
  const [title, credit] = [input("title", first.title), input("credit", first.credit)];
  const ofPaper = h("div", { class: "inline" }, "1 :", scale, dpi, "dpi");
  const show = () => {
    ofPaper.hidden = paper.value === "screen";
  };
  show();
  const settings = (): ImageSettings => ({
    paper: paper.value as Paper,
    dpi: Math.max(30, Number(dpi.value) || first.dpi),
    scale: Number(scale.value) > 0 ? Number(scale.value) : first.scale,
    title: title.value,
    credit: credit.value,
  });
  const save = (format: ImageFormat, name: string) =>
    h("button", { type: "button", class: "mode", onclick: () => take(settings(), format) }, name);
  return h(
    "div",
    { class: "map-image" },
    h("label", { class: "inline" }, "size", paper),
    ofPaper,
    h("label", { class: "inline" }, "title", title),
    h("label", { class: "inline" }, "credit", credit),
    h("div", { class: "actions" }, save("png", "PNG of the map"), save("pdf", "PDF of the map")),
  );
}
