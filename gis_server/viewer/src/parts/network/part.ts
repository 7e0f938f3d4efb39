/** The image network: its connections in words in its tab, and as a graph beside the map. */

import "./network.css";
import { h } from "../../page/dom";
import { scopeTitle } from "../../page/format";
import { type LinkEdge, type NetworkGraph, network } from "../../server/network";
import { type Context, openImage } from "../../session/context";
import { isRefusal } from "../../session/latest";
import { addPane } from "../../session/pane";
import { adjustmentSummary } from "./adjustment";
import { linkText, pairsDrawing, stopsDrawing } from "./drawing";
import { zoomable } from "./zoomable";

const NONE = "No adjustment has been made yet: there is no network.";
const MOST_LINKS = 300;

export function networkPart(context: Context): void {
  const { page, waiting, layers, state, mission } = context;
  const panel = page.addTab("network");
  const body = h("div", { class: "network-body" });
  let graph: Promise<NetworkGraph> | null = null;

  const put = (drawing: SVGSVGElement, caption: Node[]) =>
    body.replaceChildren(h("div", { class: "network-caption" }, ...caption), zoomable(drawing));
  const showStops = async () => {
    const known = await load();
    const legend = `Circles: stops as on the map with their number of pairs; lines: ties they share, red where fewer than ${known.few_ties}. Choose a stop for its pairs.`;
    const drawing = stopsDrawing(known, (stop) => state.set("network", stop));
    put(drawing, [h("small", {}, legend)]);
  };
  const showPairs = async (stop: string) => {
    const pairs = await network.pairs(mission.mission, stop);
    const all = () => state.set("network", "");
    const back = h("button", { type: "button", class: "text back", onclick: all }, "all stops");
    const text = `${scopeTitle(stop)}: pairs in the direction they look, outside those of other stops. Choose one for its image.`;
    const drawing = pairsDrawing(pairs, (id) => openImage(context, id));
    put(drawing, [back, h("small", {}, text)]);
  };
  const show = (stop: string) => (stop ? showPairs(stop) : showStops());
  addPane(context, "network", {
    title: "Image network",
    side: "beside",
    load: async () => {
      await load();
      return { element: body, show };
    },
  });
  function load(): Promise<NetworkGraph> {
    graph ??= network.graph(mission.mission);
    return graph;
  }
  const draw = async () => {
    graph = null;
    try {
      const known = await load();
      panel.replaceChildren(networkPanel(known, () => state.set("network", ""), context));
      const stop = state.get("network");
      if (stop !== null) await show(stop);
    } catch (reason) {
      if (!isRefusal(reason)) throw reason;
      panel.replaceChildren(h("p", { class: "hint" }, NONE));
    }
  };
  layers.replaced.on(() => waiting.run(draw));
  waiting.run(draw);
}

function networkPanel(graph: NetworkGraph, open: () => void, { view }: Context): HTMLElement {
  const places = new Map(graph.stops.map(({ stop, place }) => [stop, place] as const));
  const labels = new Map(graph.stops.map(({ stop, label }) => [stop, label] as const));
  const goTo = ({ one, other }: LinkEdge) => {
    const [a, b] = [places.get(one), places.get(other)];
    if (!a || !b) return;
    const [west, east] = [Math.min(a[0], b[0]), Math.max(a[0], b[0])];
    const [south, north] = [Math.min(a[1], b[1]), Math.max(a[1], b[1])];
    view.fit([west, south, east, north]);
  };
  const row = (link: LinkEdge) =>
    h(
      "tr",
      { class: link.weak.length > 0 ? "weak" : "", title: linkText(link) },
      h(
        "td",
        {},
        h(
          "button",
          { type: "button", class: "link", onclick: () => goTo(link) },
          `${labels.get(link.one) ?? link.one} – ${labels.get(link.other) ?? link.other}`,
        ),
      ),
      h("td", { class: "number" }, String(link.ties)),
      h("td", {}, link.weak[0] ?? ""),
    );
  const weakFirst = [...graph.links].sort(
    (a, b) => b.weak.length - a.weak.length || a.ties - b.ties,
  );
  const weak = graph.weaknesses.map(({ what, why }) => h("li", {}, h("b", {}, what), ` ${why}`));
  return h(
    "div",
    { class: "network-panel" },
    ...adjustmentSummary(graph),
    h(
      "div",
      { class: "actions" },
      h("button", { type: "button", class: "text graph", onclick: open }, "show the graph"),
    ),
    h("h2", {}, `Weak parts (${weak.length})`),
    weak.length > 0
      ? h("ul", { class: "weaknesses" }, ...weak)
      : h("p", { class: "hint" }, "None: all stops and pairs have enough tie points."),
    h("h2", {}, `Links between stops (${graph.links.length})`),
    h(
      "table",
      { class: "values links" },
      h(
        "thead",
        {},
        h("tr", {}, ...["stops", "ties", "weak because"].map((name) => h("th", {}, name))),
      ),
      h("tbody", {}, ...weakFirst.slice(0, MOST_LINKS).map(row)),
    ),
  );
}
