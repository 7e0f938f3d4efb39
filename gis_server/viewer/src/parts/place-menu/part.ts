/** The context menu of the map: what can be done at the place that was clicked, by mouse, long press or keyboard. */

import "./place-menu.css";
import { lonLatText } from "../../map/coordinates";
import { copyText } from "../../page/copy";
import { h } from "../../page/dom";
import { fixed } from "../../page/format";
import type { MapPoint } from "../../server/records";
import type { Context } from "../../session/context";

export function placeMenuPart(context: Context): void {
  const { page, view, places, keys, signal } = context;
  places.add({
    title: "Copy coordinates",
    run: (point) => void copyText(page, "Coordinates", coordinatesOf(context, point)),
  });
  places.add({
    title: "Copy link",
    run: (point) => void copyText(page, "Link", linkTo(context, point)),
  });
  let close = () => {};
  const open = (event: MouseEvent) => {
    event.preventDefault();
    close();
    if (view.isClaimed) return;
    const [width = 0, height = 0] = view.map.getSize() ?? [];
    const isByKey = event.button !== 2 && (event as PointerEvent).pointerType !== "touch";
    const pixel = isByKey ? [width / 2, height / 2] : view.map.getEventPixel(event);
    const [east, north] = view.map.getCoordinateFromPixel(pixel) ?? [];
    if (east !== undefined && north !== undefined) close = openMenu(context, [east, north], pixel);
  };
  page.map.addEventListener("contextmenu", open, { signal });
  view.map.on("movestart", () => close());
  document.addEventListener(
    "pointerdown",
    ({ target }) => {
      if (!(target as HTMLElement).closest(".place-menu")) close();
    },
    { signal, capture: true },
  );
  keys.add("Escape", "close the menu", () => close());
  signal.addEventListener("abort", () => close());
}

/** Adds the menu to the page; the returned function removes it. */
function openMenu(context: Context, point: MapPoint, [x = 0, y = 0]: readonly number[]) {
  const { page, view, places } = context;
  const close = () => {
    if (!menu.isConnected) return;
    const hadFocus = menu.contains(document.activeElement);
    menu.remove();
    view.setCursor(null);
    if (hadFocus) page.map.focus();
  };
  const items = places.offered.map(({ title, run }) =>
    h(
      "button",
      {
        type: "button",
        role: "menuitem",
        tabindex: -1,
        onclick: () => {
          close();
          run(point);
        },
      },
      title,
    ),
  );
  const menu = h(
    "div",
    { class: "place-menu", role: "menu", "aria-label": "at this place" },
    h("p", { role: "presentation" }, coordinatesOf(context, point)),
    ...items,
  );
  menu.addEventListener("contextmenu", (event) => event.preventDefault());
  menu.addEventListener("keydown", (event) => {
    const at = items.findIndex((item) => item === document.activeElement);
    const steps: Readonly<Record<string, number>> = {
      ...{ ArrowDown: at + 1, ArrowUp: at - 1, Home: 0, End: -1 },
    };
    const next = steps[event.key];
    if (event.key === "Tab") close();
    else if (next === undefined) return;
    else items.at(next % items.length)?.focus();
    event.preventDefault();
    event.stopPropagation(); // the arrow keys would move the map
  });
  page.map.parentElement?.append(menu);
  const { clientWidth, clientHeight } = page.map;
  menu.style.left = `${Math.max(0, Math.min(x, clientWidth - menu.offsetWidth - 4))}px`;
  menu.style.top = `${Math.max(0, Math.min(y, clientHeight - menu.offsetHeight - 4))}px`;
  view.setCursor(point);
  items[0]?.focus();
  return close;
}

function coordinatesOf({ view, coordinates }: Context, point: MapPoint): string {
  const lonLat = view.local.toLonLat(point);
  const [east, north] = point;
  if (lonLat.some(Number.isNaN)) return `N ${fixed(north, 2)} m, E ${fixed(east, 2)} m`;
  return lonLatText(lonLat, coordinates.value).join(", ");
}

/** Address of the view as it is now, with the place in its middle. */
function linkTo({ view, state }: Context, [east, north]: MapPoint): string {
  const link = state.linkWith({ at: { ...view.place, east, north } });
  return new URL(link, location.href).href;
}
