/** Files that are dropped on the map or chosen from a folder: they stay in the browser. Their readers load on use. */

import { h } from "../../page/dom";
import type { Context } from "../../session/context";
import "./local-files.css";
import type { LocalFiles } from "./files";

const ACCEPTED = ".geojson,.json,.gpkg,.zip,.tif,.tiff";
const HINT = "Drop GeoJSON, GeoPackage, zipped shapefile or GeoTIFF";

export function localFilesPart(context: Context): void {
  const { page, waiting, signal } = context;
  let files: Promise<LocalFiles> | null = null;
  const list = h("div");
  const load = () =>
    (files ??= import("./files").then(({ LocalFiles: Files }) => new Files(context, list)));
  const take = (chosen: readonly File[]) => {
    if (chosen.length > 0) waiting.act(async () => (await load()).add(chosen));
  };

  const input = h("input", {
    type: "file",
    multiple: true,
    accept: ACCEPTED,
    class: "off-screen",
    tabindex: -1,
    "aria-label": "files for the map",
    onchange: () => {
      take([...(input.files ?? [])]);
      input.value = "";
    },
  });
  const section = h(
    "section",
    { class: "local-files" },
    h(
      "button",
      { type: "button", class: "text", title: HINT, onclick: () => input.click() },
      "Add a local file…",
    ),
    input,
    list,
  );
  page.layers.after(section);
  signal.addEventListener("abort", () => section.remove());

  const target = h("div", { class: "drop-target", hidden: true }, HINT);
  page.map.after(target);
  signal.addEventListener("abort", () => target.remove());
  const hasFiles = ({ dataTransfer }: DragEvent) => dataTransfer?.types.includes("Files") ?? false;
  const over = (event: DragEvent) => {
    if (!hasFiles(event)) return;
    event.preventDefault();
    target.hidden = false;
  };
  const left = (event: DragEvent) => {
    if (event.relatedTarget === null) target.hidden = true;
  };
  const drop = (event: DragEvent) => {
    if (!hasFiles(event)) return;
    event.preventDefault();
    target.hidden = true;
    take([...(event.dataTransfer?.files ?? [])]);
  };
  const listening = { signal };
  document.addEventListener("dragover", over, listening);
  document.addEventListener("dragleave", left, listening);
  document.addEventListener("drop", drop, listening);
}
