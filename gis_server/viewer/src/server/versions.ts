/** Earlier versions of layers: what was published before, by which solution of the network. */

import { time } from "../page/format";
import { get, withQuery } from "./api";
import type { Layer } from "./records";

export interface LayerVersion {
  /** The layer; its id ends in `@` and the digest. */
  readonly layer: Layer;
  readonly is_latest: boolean;
  /** Adjustments it holds for, the one it was made for first. */
  readonly solutions: readonly {
    readonly id: string;
    readonly scope: string;
    readonly is_overall: boolean;
  }[];
  readonly run: { readonly id: string; readonly kind: string; readonly subject: string } | null;
}

export interface LayerVersions {
  readonly total: number;
  readonly versions: readonly LayerVersion[];
}

/** `sol 157, overall · 2026-11-21 23:59`: by which solution, and when it was made. */
export function versionTitle({ layer, solutions }: LayerVersion): string {
  const [first] = solutions;
  const made = time(layer.made_at);
  if (!first) return made;
  const sol = /-sol0*(\d+)/.exec(first.scope);
  const by = `${sol ? `sol ${sol[1]}` : first.scope}${first.is_overall ? ", overall" : ""}`;
  return `${by} · ${made}`;
}

/** Whether an id is of an earlier version: `scope/kind@digest`. */
export const isVersion = (id: string) => id.includes("@");

const named = (found: LayerVersion): LayerVersion => ({
  ...found,
  layer: { ...found.layer, version: versionTitle(found) },
});

export const versions = {
  list: async ({ scope, kind }: Pick<Layer, "scope" | "kind">, offset = 0, limit = 20) => {
    const answer = await get<LayerVersions>(
      withQuery(`api/layers/${scope}/${kind}/versions`, { limit, offset }),
    );
    return { ...answer, versions: answer.versions.map(named) };
  },
  /** The version that an id names. */
  one: async (id: string) => named(await get<LayerVersion>(`api/layers/${id.replace("@", "/")}`)),
};
