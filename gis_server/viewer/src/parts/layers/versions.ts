/** Earlier versions of a layer: on the map, or compared with the latest. */

import { hasValues } from "../../map/raster-style";
import { h } from "../../page/dom";
import type { Layer } from "../../server/records";
import type { LayerVersion } from "../../server/versions";
import type { LayerActions } from "./actions";

const SAME = "the adjustments since then left it as it is";

function text(name: string, label: string, run: () => void): HTMLElement {
  return h("button", { type: "button", class: "text", "aria-label": label, onclick: run }, name);
}

function entry(found: LayerVersion, latest: Layer, actions: LayerActions): HTMLElement {
  const { layer, is_latest, solutions, run } = found;
  const title = layer.version ?? layer.digest;
  const facts = [
    ...(solutions.length > 1 ? [`holds for ${solutions.length} solutions: ${SAME}`] : []),
    ...(run ? [`run: ${run.kind} of ${run.subject}`] : []),
    `digest ${layer.digest}`,
  ];
  if (is_latest)
    return h(
      "li",
      { "data-version": layer.digest, title: facts.join("\n") },
      h("b", {}, title),
      " on the map",
    );
  const box = h("input", {
    type: "checkbox",
    checked: actions.isThere(layer),
    onchange: () => (box.checked ? actions.add(layer) : actions.dismiss(layer)),
  });
  const compare = (how: "swipe" | "difference" | "flicker") => () => {
    box.checked = true;
    actions.compare(layer, latest, how);
  };
  return h(
    "li",
    { "data-version": layer.digest, title: facts.join("\n") },
    h("label", { class: "inline" }, box, title),
    h(
      "div",
      { class: "actions" },
      latest.type === "raster" ? text("swipe", `swipe ${title}`, compare("swipe")) : null,
      hasValues(latest) ? text("difference", `difference ${title}`, compare("difference")) : null,
      text("flicker", `flicker ${title}`, compare("flicker")),
    ),
  );
}

/** Fetches when it is opened. */
export function versionsOf(layer: Layer, actions: LayerActions): HTMLElement {
  const list = h("ul", { class: "version-list" });
  const more = h("button", { type: "button", class: "text", hidden: true }, "earlier ones");
  let count = 0;
  const fetch = async () => {
    const { total, versions } = await actions.versions(layer, count);
    count += versions.length;
    list.append(...versions.map((one) => entry(one, layer, actions)));
    more.hidden = count >= total || versions.length === 0;
    if (total === 1) list.append(h("li", { class: "hint" }, "No other version was published."));
  };
  more.addEventListener("click", () => void fetch());
  return h(
    "details",
    { class: "versions", ontoggle: () => count === 0 && void fetch() },
    h("summary", {}, "versions"),
    list,
    more,
  );
}
