/** Metres east and north of the origin along the lower edge and both sides of the map, and grid lines, while north is up. */

import { APART_PX, coordinateLabel, isNorthUp, type Tick, ticks } from "../../map/frame-ticks";
import { h } from "../../page/dom";
import type { Context } from "../../session/context";

/** Room that labels need beside the tools, the scale bar and the corners of the map. */
const ROOM_PX = 36;

const endOf = (element: HTMLElement, from: "Left" | "Top", size: "Width" | "Height") =>
  element[`offset${from}`] + element[`offset${size}`] + ROOM_PX / 2;

export function mapFrame({ page, view, state, signal }: Context): void {
  const edge = (name: string) => h("div", { class: `frame ${name}`, "aria-hidden": "true" });
  const [below, left, right] = [edge("eastings"), edge("northings"), edge("northings opposite")];
  const grid = edge("grid");
  page.map.append(grid, below, left, right);
  /** Upper left corner of the legend; where there is none, the lower right one of the map. */
  const legendStart = () => {
    const [legend] = page.legend.children;
    return legend instanceof HTMLElement && legend.offsetWidth > 0
      ? ([legend.offsetLeft, legend.offsetTop] as const)
      : ([page.map.clientWidth, page.map.clientHeight] as const);
  };
  const draw = () => {
    page.toolbar.parentElement?.style.setProperty("--tools", `${page.toolbar.offsetWidth}px`);
    const [width = 0, height = 0] = view.map.getSize() ?? [];
    const { east, north, resolution, rotationDeg } = view.place;
    const isUpright = isNorthUp(rotationDeg);
    for (const one of [below, left, right]) one.hidden = !isUpright;
    grid.hidden = !isUpright || !state.get("grid");
    if (!isUpright) return;
    const [legendLeft, legendTop] = legendStart();
    const easts = ticks(east, resolution, width, APART_PX);
    const norths = ticks(north, -resolution, height, APART_PX);
    const put = (edge: HTMLElement, all: readonly Tick[], first: number, end: number) => {
      const [side, names] = edge === below ? (["left", "EW"] as const) : (["top", "NS"] as const);
      const free = all.filter(({ px }) => px > first && px < end - ROOM_PX);
      edge.replaceChildren(
        ...free.map(({ px, metres }) =>
          h("span", { style: `${side}:${px.toFixed(1)}px` }, coordinateLabel(metres, names)),
        ),
      );
    };
    grid.replaceChildren(
      ...easts.map(({ px }) => h("i", { class: "easting", style: `left:${px.toFixed(1)}px` })),
      ...norths.map(({ px }) => h("i", { class: "northing", style: `top:${px.toFixed(1)}px` })),
    );
    put(below, easts, endOf(page.scale, "Left", "Width"), legendLeft);
    put(left, norths, endOf(page.toolbar, "Top", "Height"), page.scale.offsetTop);
    put(right, norths, endOf(page.north, "Top", "Height"), legendTop);
  };
  state.on("grid", draw);
  view.view.on("change", draw);
  view.map.on("change:size", draw);
  const resized = new ResizeObserver(draw); // tools come one by one
  resized.observe(page.toolbar);
  page.legend.addEventListener("toggle", draw, { capture: true, signal });
  signal.addEventListener("abort", () => {
    resized.disconnect();
    for (const one of [grid, below, left, right]) one.remove();
  });
  draw();
}
