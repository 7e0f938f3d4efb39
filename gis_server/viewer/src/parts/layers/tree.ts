/**
 * All layers: the region's, then those of every sol, then those of every stop. Rows are made when a group is opened.
 */

import { areIn, type Sols } from "../../map/sols";
import { groupLayers, type LayerGroup } from "../../map/layers";
import { h } from "../../page/dom";
import { sols } from "../../page/format";
import type { Layer } from "../../server/records";
import type { Following, LayerActions } from "./actions";
import { ALL, isAll, matches, type LayerCondition } from "./filter";
import { row } from "./row";

export interface LayerTree {
  readonly element: HTMLElement;
  /** Shows the state of a layer in its row. */
  readonly follow: (layer: Layer) => void;
  /** Lists only layers of some sols. */
  readonly setSols: (range: Sols) => void;
  /** Lists only the layers that match. */
  readonly find: (condition: LayerCondition) => void;
}

interface Group {
  readonly element: HTMLDetailsElement;
  readonly item: LayerGroup;
  readonly rows: Map<string, Following>;
  readonly setSols: (range: Sols) => void;
  readonly find: (condition: LayerCondition) => void;
}

function group(item: LayerGroup, open: boolean, actions: LayerActions): Group {
  const days = item.level === "stop" ? sols(item.layers.flatMap((layer) => layer.sols)) : "";
  const rows = new Map<string, Following>();
  const list = h("ul");
  let only: Sols = null;
  let wasOpen = open;
  let condition = ALL;
  const isListed = (layer: Layer) =>
    areIn(layer.sols, only) && matches(layer, `${item.title} ${days}`, condition);
  const hide = () => {
    for (const layer of item.layers) {
      const made = rows.get(layer.id);
      if (made) made.element.hidden = !isListed(layer);
    }
    element.hidden = !item.layers.some(isListed);
  };
  const fill = () => {
    if (!element.open || rows.size > 0) return;
    for (const layer of item.layers) rows.set(layer.id, row(layer, actions));
    list.append(...[...rows.values()].map((made) => made.element));
    hide();
  };
  const element = h(
    "details",
    { class: "group", open, ontoggle: fill, "data-scope": item.key },
    h("summary", {}, h("span", {}, item.title), days ? h("small", {}, days) : null),
    list,
  );
  fill();
  const setSols = (range: Sols) => {
    only = range;
    hide();
  };
  const find = (now: LayerCondition) => {
    if (!isAll(now) && isAll(condition)) wasOpen = element.open;
    condition = now;
    hide();
    element.open = isAll(condition) ? wasOpen : !element.hidden;
    fill();
  };
  return { element, item, rows, setSols, find };
}

export function layerTree(layers: readonly Layer[], actions: LayerActions): LayerTree {
  const groups = groupLayers(layers).map((item) => {
    const shown = item.layers.some((layer) => actions.stateOf(layer).visible);
    return group(item, shown || item.level === "region", actions);
  });
  const owner = new Map(groups.flatMap((one) => one.item.layers.map(({ id }) => [id, one])));
  const element = h("div", { class: "layers" }, ...groups.map((one) => one.element));
  if (groups.length === 0) element.append(h("p", { class: "hint" }, "No layer is published yet."));
  return {
    element,
    follow: ({ id }) => owner.get(id)?.rows.get(id)?.follow(),
    setSols: (range) => {
      for (const one of groups) one.setSols(range);
    },
    find: (condition) => {
      for (const one of groups) one.find(condition);
    },
  };
}
