/** One layer to the left of a divider, another to the right. */

import { clip } from "../../map/clipping";
import { divider } from "./divider";
import { layerName } from "./panel";
import type { Show } from "./part";

export const showSwipe: Show = (context, comparison, [a, b], _box, change) => {
  const { view, layers, page } = context;
  if (a.id === b.id) throw new Error("a layer cannot be compared with itself: choose another as B");
  let { at } = comparison;
  const share = () => at;
  for (const layer of [a, b])
    if (!layers.state(layer).visible) layers.change(layer, { visible: true });
  const sides = [
    [a, "left"],
    [b, "right"],
  ] as const;
  const undo = sides.map(([{ id }, side]) => {
    const shown = view.made(id);
    return shown ? clip(shown.map, view.map, side, share) : () => undefined;
  });
  const line = divider(page.map, layerName(a), layerName(b), (moved) => {
    at = moved;
    view.map.render();
    change({ at });
  });
  line.set(at);
  page.map.append(line.element);
  view.map.render();
  return () => {
    for (const each of undo) each();
    line.element.remove();
    view.map.render();
  };
};
