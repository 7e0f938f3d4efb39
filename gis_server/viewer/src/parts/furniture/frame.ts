/** Metres east and north of the origin along the lower and left edge of the map, while north is up. */

import { type Tick, ticks } from "../../map/frame-ticks";
import { h } from "../../page/dom";
import type { Context } from "../../session/context";

/** Room that labels need beside the tools, the scale bar and the corners of the map. */
const ROOM_PX = 36;
/** Least distance of two labels beside and above each other. */
const [APART_X_PX, APART_Y_PX] = [110, 60];

const endOf = (element: HTMLElement, from: "Left" | "Top", size: "Width" | "Height") =>
  element[`offset${from}`] + element[`offset${size}`] + ROOM_PX / 2;

const named = (metres: number, [plus, minus]: readonly [string, string]) =>
  metres === 0 ? "0 m" : `${metres > 0 ? plus : minus} ${Math.abs(metres)} m`;

export function mapFrame({ page, view, alive }: Context): void {
  const [below, left] = ["frame-east", "frame-north"].map((name) =>
    h("div", { class: `frame ${name}`, "aria-hidden": "true" }),
  );
  if (!below || !left) return;
  page.map.append(below, left);
  const legendStart = () => {
    const [legend] = page.legend.children;
    const isThere = legend instanceof HTMLElement && legend.offsetWidth > 0;
    return isThere ? legend.offsetLeft : page.map.clientWidth;
  };
  const draw = () => {
    const [width = 0, height = 0] = view.map.getSize() ?? [];
    const { east, north, resolution, rotationDeg } = view.place;
    const isUpright = Math.abs(rotationDeg) < 0.05;
    below.hidden = left.hidden = !isUpright;
    if (!isUpright) return;
    const spans = (all: readonly Tick[], side: "left" | "top", names: readonly [string, string]) =>
      all.map(({ px, metres }) =>
        h("span", { style: `${side}:${px.toFixed(1)}px` }, named(metres, names)),
      );
    const [first, top] = [endOf(page.scale, "Left", "Width"), endOf(page.toolbar, "Top", "Height")];
    const [last, bottom] = [legendStart() - ROOM_PX, page.scale.offsetTop - ROOM_PX];
    const easts = ticks(east, resolution, width, APART_X_PX).filter(
      ({ px }) => px > first && px < last,
    );
    const norths = ticks(north, -resolution, height, APART_Y_PX).filter(
      ({ px }) => px > top && px < bottom,
    );
    below.replaceChildren(...spans(easts, "left", ["E", "W"]));
    left.replaceChildren(...spans(norths, "top", ["N", "S"]));
  };
  view.view.on("change", draw);
  view.map.on("change:size", draw);
  const resized = new ResizeObserver(draw); // tools come one by one
  resized.observe(page.toolbar);
  page.legend.addEventListener("toggle", draw, { capture: true, signal: alive });
  alive.addEventListener("abort", () => {
    resized.disconnect();
    below.remove();
    left.remove();
  });
  draw();
}
