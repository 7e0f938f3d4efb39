/**
 * The server's answers about the adjusted network: its solutions, their differences, its graph, the ties of an image.
 */

import { get, of, withQuery } from "./api";

/** (east, north, up), metres in the local map; up is null where a solution gives none. */
export type Place3 = readonly [east: number, north: number, up: number | null];

export interface Solution {
  /** Parameters of the requests. */
  readonly id: string;
  readonly sol: number;
  readonly digest: string;
  readonly is_overall: boolean;
  readonly is_latest: boolean;
  readonly made_at: string;
}

export interface TraverseRow {
  readonly stop: string;
  readonly label: string;
  readonly sol: number;
  readonly distance_m: number;
  readonly place: Place3;
  readonly reference: Place3;
  readonly offset_m: Place3;
  readonly horizontal_m: number;
  readonly sigma_horizontal_m: number;
  readonly percent: number | null;
  readonly leg_m: number | null;
  readonly sigma_north_m: number;
  readonly sigma_east_m: number;
  readonly sigma_up_m: number | null;
  readonly reference_sigma_up_m: number | null;
  readonly held: boolean;
  readonly held_by: string;
}

export interface TraverseAnswer {
  readonly solution: string;
  /** `telemetry`, or the id of another solution. */
  readonly reference: string;
  readonly rows: readonly TraverseRow[];
  /** Numbers of rows. */
  readonly end: number;
  readonly worst: number;
  readonly farthest: number;
  readonly by_sol: readonly number[];
}

export interface StopNode {
  readonly stop: string;
  readonly label: string;
  readonly sols: readonly number[];
  readonly place: Place3;
  readonly pairs: number;
  readonly held_by: string;
  readonly is_tied: boolean;
  readonly weak: readonly string[];
}

export interface LinkEdge {
  readonly one: string;
  readonly other: string;
  readonly ties: number;
  readonly tried: string | null;
  readonly weak: readonly string[];
}

export interface Weak {
  readonly what: string;
  readonly why: string;
}

export type TieKind = "intra-stereo" | "inter-stereo" | "cross-site";

export interface Agreement {
  readonly comparisons: number;
  readonly mean_2d_px: number | null;
  readonly mean_3d_m: number | null;
}

export interface Adjustment {
  readonly converged: boolean;
  readonly iterations: number;
  readonly sigma0: number | null;
  /** 0: nothing but telemetry. */
  readonly redundancy: number;
  readonly pairs: number;
  readonly ties: Readonly<Partial<Record<TieKind, number>>>;
  readonly blunders: number;
  readonly control: number;
  readonly before: Readonly<Partial<Record<TieKind, Agreement>>>;
  readonly after: Readonly<Partial<Record<TieKind, Agreement>>>;
  readonly message: string;
}

export interface NetworkGraph {
  readonly network: { readonly scope: string; readonly digest: string };
  readonly adjustment: Adjustment;
  readonly few_ties: number;
  readonly stops: readonly StopNode[];
  readonly links: readonly LinkEdge[];
  readonly weaknesses: readonly Weak[];
}

export interface PairNode {
  readonly id: string;
  readonly stop: string;
  readonly sol: number | null;
  readonly instrument: string | null;
  readonly azimuth_deg: number;
  readonly elevation_deg: number;
  readonly ties: number;
  readonly blunders: number;
  readonly weak: readonly string[];
}

export interface PairEdge {
  readonly one: string;
  readonly other: string;
  readonly ties: number;
}

export interface PairGraph {
  readonly stop: string;
  readonly pairs: readonly PairNode[];
  readonly edges: readonly PairEdge[];
}

export interface ImageTie {
  readonly point: number;
  readonly kind: string;
  readonly sample: number;
  readonly line: number;
  readonly residual_sample_px: number | null;
  readonly residual_line_px: number | null;
  readonly standardised: number | null;
  readonly status: "used" | "blunder" | "unused";
  readonly pairs: readonly string[];
  readonly place: Place3 | null;
  readonly sigma_m: number | null;
}

export interface ImageTies {
  readonly image: string;
  readonly samples: number;
  readonly lines: number;
  readonly ties: readonly ImageTie[];
}

export const network = {
  solutions: (mission: string) => get<readonly Solution[]>(`${of(mission)}/solutions`),
  traverse: (mission: string, solution: string, reference: string, signal?: AbortSignal) =>
    get<TraverseAnswer>(withQuery(`${of(mission)}/traverse`, { solution, reference }), signal),
  graph: (mission: string) => get<NetworkGraph>(`${of(mission)}/network`),
  pairs: (mission: string, stop: string) =>
    get<PairGraph>(withQuery(`${of(mission)}/network/pairs`, { stop })),
  ties: (mission: string, image: string, signal?: AbortSignal) =>
    get<ImageTies>(`${of(mission)}/images/${encodeURIComponent(image)}/ties`, signal),
};
