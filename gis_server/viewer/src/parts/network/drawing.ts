/** The graph as a drawing: nodes are buttons, edges have labels. */

import { svg } from "../../page/svg";
import type { LinkEdge, NetworkGraph, PairGraph, PairNode, StopNode } from "../../server/network";
import { edgeWidth, pairSpots, SIDE, type Spot, stopSpots } from "./layout";

type Act = () => void;

function pressable(element: SVGElement, name: string, act: Act): SVGElement {
  element.setAttribute("role", "button");
  element.setAttribute("tabindex", "0");
  element.setAttribute("aria-label", name);
  element.addEventListener("click", act);
  element.addEventListener("keydown", (event) => {
    const { key } = event as KeyboardEvent;
    if (key !== "Enter" && key !== " ") return;
    event.preventDefault();
    act();
  });
  return element;
}

function edge(from: Spot, to: Spot, ties: number, classes: string, text: string): SVGElement {
  const line = svg("line", {
    x1: from.x,
    y1: from.y,
    x2: to.x,
    y2: to.y,
    "stroke-width": ties > 0 ? edgeWidth(ties).toFixed(1) : 3,
    "stroke-dasharray": ties > 0 ? null : "14 12",
  });
  const [x, y] = [(from.x + to.x) / 2, (from.y + to.y) / 2];
  const count = svg("text", { x, y, class: "edge-count" }, String(ties));
  return svg("g", { class: classes }, svg("title", {}, text), line, count);
}

export const linkText = ({ one, other, ties, tried, weak }: LinkEdge): string =>
  [`${one} and ${other} share ${ties} tie points`, tried, ...weak].filter(Boolean).join("; ");

function sheet(title: string, parts: readonly SVGElement[]): SVGSVGElement {
  const drawing = svg("svg", {
    class: "network-graph",
    viewBox: `0 0 ${SIDE} ${SIDE}`,
    role: "group",
    "aria-label": title,
  });
  drawing.append(...parts);
  return drawing;
}

export function stopsDrawing(graph: NetworkGraph, open: (stop: string) => void): SVGSVGElement {
  const spots = stopSpots(graph.stops);
  const edges = graph.links.flatMap((link) => {
    const [from, to] = [spots.get(link.one), spots.get(link.other)];
    if (!from || !to) return [];
    const drawn = edge(
      from,
      to,
      link.ties,
      link.weak.length > 0 ? "edge weak" : "edge",
      linkText(link),
    );
    drawn.setAttribute("data-link", `${link.one} ${link.other}`);
    return [drawn];
  });
  const node = (stop: StopNode) => {
    const { x, y } = spots.get(stop.stop) ?? { x: 0, y: 0 };
    const isWeak = stop.weak.length > 0 || !stop.is_tied;
    const name = `${stop.label} ${stop.pairs} pairs; ${[stop.held_by, ...stop.weak].join("; ")}`;
    const drawn = svg(
      "g",
      { class: isWeak ? "node weak" : "node", "data-stop-node": stop.stop },
      svg("circle", { cx: x, cy: y }),
      svg("text", { x, y, dy: "-1.4em" }, stop.label),
      " ", // else the name would be read as 10/012
      svg("text", { x, y, dy: "0.35em", class: "inside" }, String(stop.pairs)),
    );
    return pressable(drawn, name, () => open(stop.stop));
  };
  return sheet("stops and the ties between them", [...edges, ...graph.stops.map(node)]);
}

const shortName = ({ id, instrument }: PairNode) => `${instrument ?? ""} ${id.slice(2, 11)}`.trim();

export function pairsDrawing(graph: PairGraph, open: (image: string) => void): SVGSVGElement {
  const spots = pairSpots(graph);
  const edges = graph.edges.flatMap(({ one, other, ties }) => {
    const [from, to] = [spots.get(one), spots.get(other)];
    return from && to
      ? [edge(from, to, ties, "edge pair-edge", `${one} and ${other} share ${ties} ties`)]
      : [];
  });
  const node = (pair: PairNode) => {
    const { x, y } = spots.get(pair.id) ?? { x: 0, y: 0 };
    const own = pair.stop === graph.stop ? "" : ` of ${pair.stop}`;
    const name = `${shortName(pair)}, pair ${pair.id}${own}: ${pair.ties} ties, ${pair.blunders} set aside ${pair.weak.join("; ")}`;
    const classes = ["node", "pair", own ? "foreign" : "", pair.weak.length > 0 ? "weak" : ""];
    const drawn = svg(
      "g",
      { class: classes.join(" "), "data-pair": pair.id },
      svg("circle", { cx: x, cy: y }),
      svg("text", { x, y, dy: "-1.2em", class: "small" }, shortName(pair)),
    );
    return pressable(drawn, name, () => open(pair.id));
  };
  return sheet(`pairs of ${graph.stop}`, [...edges, ...graph.pairs.map(node)]);
}
