/**
 * State of the editor, independent of drawing: the pick of a feature in two images, the planned ties, and the result
 * of a preview with them. A preview is dropped when the ties change.
 */

import type { PixelOf, Refined, TieRequest, Trial } from "../../server/ties";

export interface Pick extends PixelOf {
  /** Standard deviation of one coordinate; null: that of a manual pick. */
  readonly sigma_px: number | null;
}

export interface PlannedTie {
  readonly first: Pick;
  readonly second: Pick;
}

export interface Draft {
  readonly first: Pick | null;
  readonly second: Pick | null;
  readonly planned: readonly PlannedTie[];
  readonly trial: Trial | null;
}

export const EMPTY: Draft = { first: null, second: null, planned: [], trial: null };

/** Picks another feature, and drops the second pick of the earlier one. */
export const withFirst = (draft: Draft, first: PixelOf): Draft => ({
  ...draft,
  first: { ...first, sigma_px: null },
  second: null,
});

export const withSecond = (draft: Draft, second: PixelOf): Draft => ({
  ...draft,
  second: { ...second, sigma_px: null },
});

/** The second pick where it was measured; where it was not found it stays as it was picked. */
export function withMeasured(draft: Draft, { found, sample, line, sigma_px }: Refined): Draft {
  if (!draft.second || !found) return draft;
  return { ...draft, second: { ...draft.second, sample, line, sigma_px } };
}

/** Plans the tie between both picks; a tie between the same pixels is planned once. */
export function planned(draft: Draft): Draft {
  const { first, second } = draft;
  if (!first || !second) return draft;
  const others = draft.planned.filter(
    (tie) => !isSame(tie.first, first) || !isSame(tie.second, second),
  );
  return { first: null, second: null, planned: [...others, { first, second }], trial: null };
}

export const without = (draft: Draft, row: number): Draft => ({
  ...draft,
  planned: draft.planned.toSpliced(row, 1),
  trial: null,
});

export const tieRequests = (draft: Draft): readonly TieRequest[] => draft.planned.map(requestOf);

export function requestOf({ first, second }: PlannedTie): TieRequest {
  const sigma = second.sigma_px === null ? {} : { sigma_px: Math.max(second.sigma_px, LEAST_PX) };
  return { action: "add", first: pixel(first), second: pixel(second), ...sigma };
}

/** The standard deviation of least-squares matching is too small: neighbouring pixels have common errors. */
const LEAST_PX = 0.1;
const SAME_PX = 0.5;
/** A pick as the server stores it. */
export const pixel = ({ image, sample, line }: Pick): PixelOf => ({ image, sample, line });
const isSame = (a: Pick, b: Pick) =>
  a.image === b.image && Math.hypot(a.sample - b.sample, a.line - b.line) < SAME_PX;
