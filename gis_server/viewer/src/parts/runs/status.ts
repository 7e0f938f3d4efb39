/** Status of the server and the workflow engine, below the map. */

import { h } from "../../page/dom";
import type { Engine } from "../../server/runs";
import type { Context } from "../../session/context";

/** Returns a function to call with each new state of the engine. */
export function statusIndicator(
  { page, events, signal }: Context,
  open: () => void,
): (engine: Engine | null) => void {
  const server = h("span", { "data-part": "server" });
  const engine = h("span", { "data-part": "engine" });
  const button = h("button", { type: "button", class: "text", onclick: open }, server, engine);
  page.statusBox.append(button);
  let last: Engine | null = null;
  const draw = () => {
    const isConnected = page.connectionLost.hidden;
    server.textContent = isConnected ? "Server up" : "Server down";
    server.dataset["up"] = String(isConnected);
    const state = last && isConnected ? (last.is_up ? "up" : "down") : "unknown";
    engine.textContent = `Engine ${state}`;
    engine.dataset["up"] = String(state === "up");
    engine.hidden = last?.is_known === false;
    button.title = (engine.hidden ? null : last?.trouble) ?? "Show runs and scheduled processing";
  };
  const watch = new MutationObserver(draw);
  watch.observe(page.connectionLost, { attributes: true, attributeFilter: ["hidden"] });
  events.reconnected.on(draw);
  signal.addEventListener("abort", () => watch.disconnect());
  draw();
  return (state) => {
    last = state;
    draw();
  };
}
