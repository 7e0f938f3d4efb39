/** The pointer over the map: the feature under it, and the cursor for other parts. */

import { CLICKABLE } from "../../map/map-view";
import { h } from "../../page/dom";
import type { Context, Pointed } from "../../session/context";
import { type Tip, tipOf } from "./tip";

export function cursorPart({ page, view, events, signal }: Context): void {
  const over = (pointed: Pointed) => {
    const { touched, pixel } = pointed;
    page.map.style.cursor = touched && CLICKABLE.has(touched.layer.kind) ? "pointer" : "";
    page.tip.hidden = !touched;
    if (touched) {
      page.tip.replaceChildren(...lines(tipOf(touched.layer, touched.feature.getProperties())));
      placeTip(page.tip, page.map, pixel);
    }
    events.pointer.emit(pointed);
  };
  view.onPointer((event, point) => {
    if (event.dragging) return;
    const touched = view.isClaimed ? null : view.touched(event.pixel);
    over({ point, pixel: event.pixel, touched });
  });
  view.onClick((event, point) => {
    page.tip.hidden = true;
    events.click.emit({
      point,
      pixel: event.pixel,
      touched: view.touched(event.pixel, CLICKABLE),
    });
  });
  page.map.addEventListener(
    "pointerleave",
    () => {
      page.tip.hidden = true;
      events.pointer.emit(null);
    },
    { signal },
  );
  events.cursor.on((point) => view.setCursor(point));
}

/** Beside the pointer, on the side where there is room. */
function placeTip(tip: HTMLElement, map: HTMLElement, [x = 0, y = 0]: readonly number[]): void {
  const left = x + 14 + tip.offsetWidth > map.clientWidth ? x - 10 - tip.offsetWidth : x + 14;
  const top = y + 14 + tip.offsetHeight > map.clientHeight ? y - 10 - tip.offsetHeight : y + 14;
  tip.style.transform = `translate(${Math.max(4, left)}px, ${Math.max(4, top)}px)`;
}

function lines({ title, facts, caution }: Tip): Node[] {
  const spans = facts.map((fact) => h("span", {}, fact));
  return [h("b", {}, title), ...spans, ...(caution ? [h("em", {}, caution)] : [])];
}
