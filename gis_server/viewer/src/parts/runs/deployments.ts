/** The engine: whether it is up, what is scheduled, and what waits. */

import { facts, h, withCode } from "../../page/dom";
import { time } from "../../page/format";
import type { Deployment, Engine, QueuedRun } from "../../server/runs";

export interface EngineActions {
  readonly pause: (deployment: Deployment) => void;
  readonly cancelQueued: (run: QueuedRun) => void;
}

const utc = (at: string | null) => (at ? `${time(at)} UTC` : null);

/** Whether workers serve a deployment. */
export const workersText = ({ pool, is_ready }: Deployment): string =>
  `${pool ? `work pool ${pool}` : "runs in solmap up"}, ${is_ready ? "ready" : "not ready"}`;

function row(deployment: Deployment, mayAct: boolean, actions: EngineActions): HTMLElement {
  const { name, is_paused, schedules, next_run, last_state, last_ended_at } = deployment;
  const hasSchedule = schedules.length > 0;
  const last = last_state ? `${last_state}, ${utc(last_ended_at) ?? "time unknown"}` : "none yet";
  const schedule = hasSchedule ? `${schedules.join("; ")} (cron, UTC)` : "on request only";
  return h(
    "li",
    { class: "run", "data-deployment": name, "data-paused": String(is_paused) },
    h("b", {}, name),
    facts([
      ["Schedule", is_paused ? `paused; ${schedule}` : schedule],
      ["Next run", hasSchedule && !is_paused ? (utc(next_run) ?? "not scheduled yet") : null],
      ["Last run", last],
      ["Workers", workersText(deployment)],
    ]),
    mayAct && (hasSchedule || is_paused)
      ? h(
          "button",
          { type: "button", class: "link", onclick: () => actions.pause(deployment) },
          is_paused ? `Resume ${name}` : `Pause ${name}`,
        )
      : null,
  );
}

export function enginePanel(engine: Engine, mayAct: boolean, actions: EngineActions): HTMLElement {
  const queued = engine.queued.map((run) =>
    h(
      "li",
      { class: "run", "data-queued": run.flow_run },
      `${run.deployment}: ${run.name} waits`,
      mayAct
        ? h(
            "button",
            { type: "button", class: "link", onclick: () => actions.cancelQueued(run) },
            `Cancel ${run.name}`,
          )
        : null,
    ),
  );
  return h(
    "section",
    { "aria-label": "engine" },
    queued.length > 0 ? h("h2", {}, "Waiting runs") : null,
    h("ul", { class: "plain" }, ...queued),
    h("h2", {}, "Deployments"),
    engine.is_up
      ? null
      : h("p", { class: "error", role: "status" }, ...withCode(`Engine down: ${engine.trouble}.`)),
    h("ul", { class: "plain" }, ...engine.deployments.map((one) => row(one, mayAct, actions))),
  );
}
