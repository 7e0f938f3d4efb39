/** Categories of annotations, and their colours. */

import type { AnnotationCategory } from "../../server/edits";

export interface Category {
  readonly key: AnnotationCategory;
  readonly title: string;
  readonly colour: string;
}

export const CATEGORIES: readonly Category[] = [
  { key: "note", title: "Note", colour: "#6b3fa0" },
  { key: "target", title: "Target", colour: "#0b7a75" },
  { key: "waypoint", title: "Waypoint", colour: "#1d5fb4" },
  { key: "keep-out", title: "Keep-out area", colour: "#b3261e" },
  { key: "measurement", title: "Measurement", colour: "#7a5c00" },
];

const [NOTE = { key: "note", title: "Note", colour: "#6b3fa0" } as const] = CATEGORIES;

/** Older annotations have no category: they are notes. */
export const categoryOf = (key: unknown): Category =>
  CATEGORIES.find((one) => one.key === key) ?? NOTE;
