/** Runs of the pipeline, requests for new ones, and reports of adjustments. */

import { get, post } from "./api";

export type RunState = "running" | "succeeded" | "failed" | "lost" | "cancelled";

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
  /** Log of a single run; empty in lists. */
  readonly lines: readonly string[];
  readonly parameters: Parameters;
  /** Actions that an operator may request. */
  readonly actions: readonly RunAction[];
}

export type Parameters = Readonly<Record<string, unknown>>;
export type RunAction = "cancel" | "restart";

export interface RunRequest {
  readonly id: number;
  readonly kind: string;
  readonly mission: string | null;
  readonly author: string;
  readonly at: string;
  readonly state: "waiting" | "taken" | "refused";
  readonly answer: string | null;
  readonly parameters: Parameters;
}

/** A parameter of a kind of run, as JSON Schema has it. */
export interface ParameterSchema {
  readonly title?: string;
  readonly description?: string;
  readonly type?: string;
  readonly pattern?: string;
  readonly minimum?: number;
  readonly maximum?: number;
  readonly default?: unknown;
  readonly anyOf?: readonly ParameterSchema[];
  readonly items?: { readonly enum?: readonly string[] };
}

export interface RunKind {
  readonly kind: string;
  readonly title: string;
  readonly effect: string;
  readonly deployment: string;
  readonly parameters: {
    readonly properties: Readonly<Record<string, ParameterSchema>>;
    readonly required?: readonly string[];
  };
}

export interface Deployment {
  readonly name: string;
  readonly description: string;
  readonly is_paused: boolean;
  readonly schedules: readonly string[];
  readonly next_run: string | null;
  readonly last_state: string | null;
  readonly last_ended_at: string | null;
  readonly pool: string | null;
  readonly is_ready: boolean;
}

export interface QueuedRun {
  readonly flow_run: string;
  readonly deployment: string;
  readonly name: string;
  readonly expected_at: string | null;
}

export interface Engine {
  readonly at: string;
  readonly is_up: boolean;
  /** False: none runs, the server only shows the store. */
  readonly is_known: boolean;
  readonly trouble: string | null;
  readonly has_inbox: boolean;
  readonly deployments: readonly Deployment[];
  readonly queued: readonly QueuedRun[];
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

export const runs = {
  all: () => get<Runs>("api/runs"),
  one: (id: string) => get<Run>(`api/runs/${encodeURIComponent(id)}`),
  kinds: () => get<readonly RunKind[]>("api/run-kinds"),
  engine: () => get<Engine>("api/engine"),
  request: (kind: string, parameters: Parameters) =>
    post<RunRequest>("api/runs", { ...parameters, kind }),
  /** Cancels or restarts a run; a run that waits in the engine is named by its id there. */
  have: (id: string, action: RunAction) =>
    post<RunRequest>(`api/runs/${encodeURIComponent(id)}/${action}`, {}),
  pause: ({ name, is_paused }: Deployment) =>
    post<RunRequest>(`api/engine/deployments/${name}/${is_paused ? "resume" : "pause"}`, {}),
  report: async ({ page }: Report): Promise<string> => (await fetch(page)).text(),
};
