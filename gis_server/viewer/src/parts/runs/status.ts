/** State of server and engine, below the map. */

import { h } from "../../page/dom";
import type { Engine } from "../../server/runs";
import type { Context } from "../../session/context";

/** Shows the state of server and engine; returns what is called with the engine's. */
export function indicator(
  { page, signals, signal }: Context,
  open: () => void,
): (engine: Engine | null) => void {
  const server = h("span", { "data-part": "server" });
  const engine = h("span", { "data-part": "engine" });
  const button = h("button", { type: "button", class: "text", onclick: open }, server, engine);
  page.statusBox.append(button);
  let last: Engine | null = null;
  const draw = () => {
    const isConnected = page.connection.hidden;
    server.textContent = isConnected ? "Server up" : "Server down";
    server.dataset["up"] = String(isConnected);
    const state = last && isConnected ? (last.is_up ? "up" : "down") : "unknown";
    engine.textContent = `Engine ${state}`;
    engine.dataset["up"] = String(state === "up");
    engine.hidden = last?.is_known === false;
    button.title = (engine.hidden ? null : last?.trouble) ?? "Show runs and deployments";
  };
  const watch = new MutationObserver(draw);
  watch.observe(page.connection, { attributes: true, attributeFilter: ["hidden"] });
  signals.reconnected.on(draw);
  signal.addEventListener("abort", () => watch.disconnect());
  draw();
  return (found) => {
    last = found;
    draw();
  };
}
