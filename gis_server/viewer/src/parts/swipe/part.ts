/** Compares two layers: a divider between them, or their difference. The link keeps what is compared. */

import { isBand } from "../../map/bands";
import { h } from "../../page/dom";
import type { Context } from "../../session/context";
import { bringVersions } from "../../session/versions";
import { isVersion } from "../../server/versions";
import type { Layer } from "../../server/records";
import type { Comparison } from "../../session/state";
import { firstPair } from "./comparison";
import { showDifference } from "./difference";
import { comparisonPanel, layerName } from "./panel";
import "./swipe.css";
import { showSwipe } from "./swipe";

/** Shows a comparison until the returned function is called; an error gives the reason why it cannot. */
export type Show = (
  context: Context,
  comparison: Comparison,
  layers: readonly [Layer, Layer],
  box: HTMLElement,
  change: (part: Partial<Comparison>) => void,
) => () => void;

export function swipePart(context: Context): void {
  const { page, layers, state, keys, waiting, signal } = context;
  const panel = page.addTab("compare");
  const box = h("div");
  let running = state.get("compare");
  let undo: () => void = () => undefined;

  const offered = (): Comparison | null => {
    const pair = running ? null : firstPair(layers.shown, layers.all);
    return (
      running ?? (pair && { mode: "swipe", a: pair[0].id, b: pair[1].id, at: 0.5, most: null })
    );
  };
  const draw = () => {
    const rasters = layers.every.filter((layer) => layer.type === "raster" && !isBand(layer));
    const names = rasters.toSorted((a, b) =>
      layerName(a).localeCompare(layerName(b), "en", { numeric: true }),
    );
    panel.replaceChildren(
      comparisonPanel(names, offered(), running !== null, { change, stop }),
      box,
    );
  };
  const keep = (comparison: Comparison | null) => {
    running = comparison;
    state.set("compare", comparison);
  };
  const begin = () => {
    undo();
    undo = () => undefined;
    box.replaceChildren();
    const pair = running && pairOf(layers.every, running);
    if (!running || !pair) return;
    const show = running.mode === "swipe" ? showSwipe : showDifference;
    const remember = (part: Partial<Comparison>) => running && keep({ ...running, ...part });
    try {
      undo = show(context, running, pair, box, remember);
    } catch (reason) {
      const text = reason instanceof Error ? reason.message : String(reason);
      box.replaceChildren(h("p", { class: "refused", role: "alert" }, text));
      keep(null);
    }
  };
  function change(part: Partial<Comparison>): void {
    const from = offered();
    if (!from) return;
    keep({ ...from, ...part, most: null }); // other layers differ by other amounts
    begin();
    draw();
  }
  function stop(): void {
    keep(null);
    begin();
    draw();
  }
  layers.replaced.on(() => {
    begin();
    draw();
  });
  layers.changed.on(() => {
    if (!running) draw();
  });
  layers.versionsChanged.on(() => {
    const isWhole = running && pairOf(layers.every, running);
    if (running && !isWhole && !isComing) keep(null);
    begin();
    draw();
  });
  const linked = running ? [running.a, running.b].filter(isVersion) : [];
  let isComing = linked.length > 0;
  if (isComing)
    waiting.run(async () => {
      await bringVersions(context, linked);
      isComing = false;
    });
  keys.add("c", "compare two layers: swipe", () => {
    if (running) stop();
    else change({ mode: "swipe" });
    page.showTab("compare");
  });
  signal.addEventListener("abort", () => undo());
  state.on("compare", (comparison) => {
    if (comparison === running) return;
    running = comparison;
    begin();
    draw();
  });
  begin();
  draw();
}

function pairOf(all: readonly Layer[], { a, b }: Comparison): readonly [Layer, Layer] | null {
  const [first, second] = [a, b].map((id) => all.find((layer) => layer.id === id));
  return first && second ? [first, second] : null;
}
