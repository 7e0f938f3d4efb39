/** Runs of the pipeline, requests for new ones, and reports of adjustments. */

import { get, post } from "./api";

export type RunState = "running" | "succeeded" | "failed" | "lost";

export interface Run {
  readonly id: string;
  readonly kind: string;
  readonly subject: string;
  readonly state: RunState;
  readonly started_at: string;
  readonly changed_at: string;
  readonly ended_at: string | null;
  readonly stage: string | null;
  readonly done: number;
  readonly total: number;
  /** What it said; only of a single run, else empty. */
  readonly lines: readonly string[];
}

export interface RunRequest {
  readonly id: number;
  readonly kind: string;
  readonly mission: string | null;
  readonly author: string;
  readonly at: string;
  readonly state: "waiting" | "taken" | "refused";
  readonly answer: string | null;
}

export interface Report {
  readonly scope: string;
  readonly digest: string;
  readonly page: string;
}

export interface Runs {
  readonly runs: readonly Run[];
  readonly requests: readonly RunRequest[];
  readonly reports: readonly Report[];
}

export const WISHES = ["downlink", "overall adjustment", "region"] as const;
export type Wish = (typeof WISHES)[number];

export const runs = {
  all: () => get<Runs>("api/runs"),
  one: (id: string) => get<Run>(`api/runs/${encodeURIComponent(id)}`),
  ask: (kind: Wish, mission: string | null) => post<RunRequest>("api/runs", { kind, mission }),
  report: async ({ page }: Report): Promise<string> => (await fetch(page)).text(),
};
