/** Title, scale bar, north arrow, and the tools that move the map. */

import { firstBounds } from "../../map/layers";
import { scaleBar } from "../../map/scale";
import { titleOf } from "../../map/title";
import { copyText } from "../../page/copy";
import { button, h } from "../../page/dom";
import type { Context } from "../../session/context";
import { mapFrame } from "./frame";

const SCALE_PX = 160;

export function furniturePart(context: Context): void {
  const { page, view, layers, mission, keys, history, state } = context;
  mapFrame(context);
  const name = h("div", { class: "map-title" });
  page.map.append(name);
  const entitle = () => {
    const { title, parts } = titleOf(mission, layers.all, state.get("sol"));
    name.replaceChildren(
      h("b", {}, title),
      h("span", {}, ...parts.map((part) => h("i", {}, part))),
    );
  };
  state.on("sol", entitle);
  layers.replaced.on(entitle);
  entitle();
  const everything = () => view.fit(firstBounds(layers.all) ?? mission.bounds);
  page.addTool(
    button("zoom in (+)", "plus", () => view.zoomBy(0.5)),
    "zoom in",
  );
  page.addTool(
    button("zoom out (-)", "minus", () => view.zoomBy(2)),
    "zoom out",
  );
  page.addTool(button("show everything (f)", "fit", everything, { class: "fit" }), "everything");
  const toggleGrid = () => state.set("grid", !state.get("grid"));
  const gridTool = button("grid lines (#)", "grid", toggleGrid);
  page.addTool(gridTool, "grid");
  state.follow("grid", (isOn) => gridTool.setAttribute("aria-pressed", String(isOn)));
  const copyLink = () => void copyText(page, "Link", new URL(state.link, location.href).href);
  page.addTool(button("copy the link to this view (u)", "link", copyLink), "copy link");
  keys.add("Ctrl+z", "back to the view before", () => history.undo());
  keys.add("Ctrl+y", "forward to the view after", () => history.redo());
  keys.add("u", "copy the link to this view", copyLink);
  keys.add("g", "go to the map", () => page.map.focus());
  keys.add("#", "grid lines", toggleGrid);
  keys.add("f", "show everything", everything);
  keys.add("n", "north up", () => view.northUp());
  keys.add("+", "zoom in", () => view.zoomBy(0.5));
  keys.add("-", "zoom out", () => view.zoomBy(2));

  const arrow = h("span", { class: "arrow" }, h("b", {}, "N"), h("i", {}));
  page.north.replaceChildren(
    h(
      "button",
      {
        type: "button",
        title: "north up (n); turn with Alt+Shift+drag",
        "aria-label": "north up",
        onclick: () => view.northUp(),
      },
      arrow,
    ),
  );
  const tune = () => {
    const bar = scaleBar(view.resolution, SCALE_PX);
    page.scale.replaceChildren(
      h("span", {}, bar.label),
      h("i", { style: `width:${bar.px.toFixed(2)}px`, "data-metres": bar.metres }),
    );
    arrow.style.transform = `rotate(${view.place.rotationDeg}deg)`;
  };
  view.view.on("change:resolution", tune);
  view.view.on("change:rotation", tune);
  tune();
}
