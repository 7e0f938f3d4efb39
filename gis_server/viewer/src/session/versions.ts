/** Adds earlier versions that a link or a list requests to the layers. */

import { versions } from "../server/versions";
import type { Context } from "./context";

/** Fetches the versions that are not there yet; one that was deleted is reported and left out. */
export async function bringVersions(
  { layers, waiting }: Pick<Context, "layers" | "waiting">,
  ids: readonly string[],
): Promise<void> {
  const missing = ids.filter((id) => !layers.every.some((layer) => layer.id === id));
  for (const id of missing)
    try {
      layers.addVersion((await versions.one(id)).layer);
    } catch (reason) {
      waiting.fail(reason);
    }
}
