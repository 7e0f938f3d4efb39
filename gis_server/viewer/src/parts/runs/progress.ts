/** Descriptions of runs, in words and numbers. */

import type { ServerEvents } from "../../server/events";
import type { Run, RunRequest } from "../../server/runs";

/** Share of the stage that is done, 0 to 1; null where nothing is counted. */
export const share = ({ done, total }: Pick<Run, "done" | "total">): number | null =>
  total > 0 ? Math.min(1, done / total) : null;

export function stageText({ stage, done, total, state }: Run): string {
  if (state === "cancelled") return "what was made is kept; a later run continues";
  if (state === "lost") return "its process ended without a message; the next run continues";
  if (state !== "running") return "";
  if (!stage) return "starting";
  return total > 0 ? `${stage}, ${done} of ${total}` : stage;
}

/** How long a run took, or has been going on. */
export function durationText(run: Pick<Run, "started_at" | "ended_at">, now: number): string {
  const end = run.ended_at ? Date.parse(run.ended_at) : now;
  const seconds = Math.max(0, Math.round((end - Date.parse(run.started_at)) / 1000));
  if (seconds < 60) return `${seconds} s`;
  const minutes = Math.floor(seconds / 60);
  return minutes < 60 ? `${minutes} min` : `${Math.floor(minutes / 60)} h ${minutes % 60} min`;
}

/** The list updated by an event about one of its runs; null where the run is not in the list. */
export function advanced(
  runs: readonly Run[],
  event: ServerEvents["run.changed"],
): readonly Run[] | null {
  if (!runs.some(({ id }) => id === event.id)) return null;
  const { stage, done, total } = event;
  const state = event.state as Run["state"];
  return runs.map((run) => (run.id === event.id ? { ...run, state, stage, done, total } : run));
}

export function requestText(request: RunRequest): string {
  const { kind, mission, author, state, answer, parameters } = request;
  const of = mission ?? parameters["deployment"] ?? parameters["run"];
  const what = `${kind}${of ? ` of ${String(of)}` : ""}, requested by ${author}`;
  switch (state) {
    case "waiting":
      return `${what}: waits for \`solmap up\` to take it`;
    case "taken":
      return `${what}: run ${answer ?? ""}`;
    default:
      return `${what}: refused, ${answer ?? "no reason given"}`;
  }
}
