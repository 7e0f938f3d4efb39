/** Selected sols: from a first to a last one, or all. */

import type { Codec } from "../codec";

export type Sols = readonly [from: number, to: number] | null;

export const isIn = (sol: number, range: Sols): boolean =>
  range === null || (range[0] <= sol && sol <= range[1]);

/** Whether a feature with these sols is in a range; one without sols is in all. */
export const areIn = (sols: readonly number[], range: Sols): boolean =>
  sols.length === 0 || sols.some((sol) => isIn(sol, range));

export const isSame = (a: Sols, b: Sols): boolean => a?.[0] === b?.[0] && a?.[1] === b?.[1];

/** Sols in a link: `156` or `150-156`. */
export const linkedSols: Codec<readonly [number, number]> = {
  read: (text) => {
    const [, from, to = from] = /^(\d+)(?:-(\d+))?$/.exec(text) ?? [];
    if (from === undefined) return undefined;
    const [a, b] = [Number(from), Number(to)];
    return [Math.min(a, b), Math.max(a, b)];
  },
  write: ([from, to]) => (from === to ? String(from) : `${from}-${to}`),
};

export function solsTitle(range: Sols): string {
  if (range === null) return "all sols";
  return range[0] === range[1] ? `sol ${range[0]}` : `sols ${range[0]}–${range[1]}`;
}
