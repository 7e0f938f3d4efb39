/** Edits by people: ties and annotations, in an append-only log. */

import { get, of, post } from "./api";

export interface Edit {
  readonly id: number;
  readonly kind: "tie" | "annotation" | "undo";
  readonly document: Readonly<Record<string, unknown>>;
  readonly author: string;
  readonly at: string;
  readonly note: string;
  readonly undoes: number | null;
  readonly counts: boolean;
}

export interface TieEdit {
  readonly action: "add" | "veto" | "move";
  readonly first_image: string;
  readonly first_sample?: number;
  readonly first_line?: number;
  readonly second_image: string;
  readonly second_sample?: number;
  readonly second_line?: number;
  readonly sigma_px?: number;
  readonly note: string;
}

export type AnnotationCategory = "note" | "target" | "waypoint" | "keep-out" | "measurement";
/** Drafts are on the map, not in OGC services and downloads. */
export type AnnotationState = "draft" | "published";

export interface AnnotationEdit {
  readonly geometry: { readonly type: string; readonly coordinates: unknown };
  readonly text: string;
  readonly category: AnnotationCategory;
  readonly state: AnnotationState;
  readonly colour?: string;
  /** The annotation that this one replaces. */
  readonly replaces?: number;
}

export interface AnnotationFeature {
  readonly type: "Feature";
  readonly id: string;
  readonly geometry: { readonly type: string; readonly coordinates: unknown };
  readonly properties: {
    readonly text: string;
    readonly category?: AnnotationCategory;
    readonly state?: AnnotationState;
    readonly colour?: string;
    readonly author: string;
    readonly at: string;
  };
}

export const edits = {
  ties: (mission: string) => get<readonly Edit[]>(`${of(mission)}/edits?kind=tie&counting=true`),
  addTie: (mission: string, tie: TieEdit) => post<Edit>(`${of(mission)}/edits/ties`, tie),
  undo: (mission: string, id: number) => post<Edit>(`${of(mission)}/edits/${id}/undo`, {}),
  annotate: (mission: string, annotation: AnnotationEdit) =>
    post<Edit>(`${of(mission)}/edits/annotations`, annotation),
  /** All edits, including those without effect. */
  log: (mission: string) => get<readonly Edit[]>(`${of(mission)}/edits`),
  annotations: (mission: string) =>
    get<{ readonly features: readonly AnnotationFeature[] }>(`${of(mission)}/annotations`),
};
