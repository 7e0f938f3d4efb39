/** Live updates: what is published while the page is open appears by itself. */

import { api, UnreachableError } from "../../server/api";
import { type ServerEvent, listen } from "../../server/events";
import type { Context } from "../../session/context";
import { gathered, publishedText } from "./gather";

/** A sol publishes layer after layer: the list is fetched this long after the last event. */
const QUIET_MS = 400;
/** A list whose request failed is requested again after this time. */
const AGAIN_MS = 2000;
const RELOAD: ServerEvent = { kind: "reload", document: {} };

export function livePart(context: Context): void {
  const { mission, layers, page, waiting, events, lastEvent, signal } = context;
  let isBehind = false;
  const refresh = async (ids: readonly string[]) => {
    try {
      layers.replace(await api.layers(mission.mission));
    } catch (reason) {
      if (reason instanceof UnreachableError && !signal.aborted) {
        isBehind = true;
        published.add(ids, AGAIN_MS);
      }
      throw reason;
    }
    if (ids.length > 0) page.toast(publishedText(ids));
    if (!isBehind) return;
    isBehind = false; // requests of other parts may have failed too
    waiting.answered();
    events.serverEvent.emit(RELOAD);
  };
  const published = gathered<readonly string[]>(QUIET_MS, (all) =>
    waiting.act(() => refresh(all.flat())),
  );
  signal.addEventListener("abort", published.cancel);
  const receive = (event: ServerEvent) => {
    events.serverEvent.emit(event);
    if (event.kind === "layers.published") published.add(event.document.layers);
    if (event.kind === "reload") published.add([]);
  };
  let wasLost = false;
  listen(mission.mission, lastEvent, signal, receive, (isConnected) => {
    page.connectionLost.hidden = isConnected;
    if (isConnected && wasLost) events.reconnected.emit();
    wasLost = !isConnected;
  });
  signal.addEventListener("abort", () => (page.connectionLost.hidden = true));
}
