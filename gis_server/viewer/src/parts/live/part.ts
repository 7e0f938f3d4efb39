/** Live updates: what is published while the page is open appears by itself. */

import { api } from "../../server/api";
import { listen } from "../../server/events";
import type { Context } from "../../session/context";
import { gathered, publishedText } from "./gather";

/** A sol publishes layer after layer: the list is asked for when it has gone quiet so long. */
const QUIET_MS = 400;

export function livePart(context: Context): void {
  const { mission, layers, page, waiting, signals, alive } = context;
  const refresh = (ids: readonly string[]) =>
    waiting.run(async () => {
      layers.replace(await api.layers(mission.mission));
      if (ids.length > 0) page.toast(publishedText(ids));
    });
  const published = gathered<readonly string[]>(QUIET_MS, (all) => refresh(all.flat()));
  alive.addEventListener("abort", published.cancel);
  listen(mission.mission, alive, (happening) => {
    signals.happened.emit(happening);
    if (happening.kind === "layers.published") published.add(happening.document.layers);
    if (happening.kind === "reload") published.add([]);
  });
}
