/** The tab of runs, drawn from what is known of them. */

import { h, withCode } from "../../page/dom";
import { time } from "../../page/format";
import type { Engine, Report, Run, RunAction, RunKind, Runs } from "../../server/runs";
import { durationText, requestText, share, stageText } from "./progress";

const ACTION_TEXTS: Readonly<Record<RunAction, string>> = {
  cancel: "Cancel",
  restart: "Retry what failed",
};

export interface RunActions {
  readonly open: (run: Run) => void;
  readonly openReport: (report: Report) => void;
  readonly start: (kind: RunKind) => void;
  readonly have: (run: Run, action: RunAction) => void;
}

function bar(run: Run): HTMLElement | null {
  const part = share(run);
  if (run.state !== "running" || part === null) return null;
  return h("progress", { max: 1, value: part, "aria-label": `${run.kind}: ${stageText(run)}` });
}

function row(run: Run, mayStartRuns: boolean, actions: RunActions): HTMLElement {
  const title = `${run.kind}${run.subject ? `: ${run.subject}` : ""}`;
  return h(
    "li",
    { class: `run ${run.state}`, "data-run": run.id, "data-state": run.state },
    h("button", { type: "button", class: "link", onclick: () => actions.open(run) }, title),
    h("small", {}, `${run.state} · ${time(run.started_at)} UTC · ${durationText(run, Date.now())}`),
    h("span", { class: "stage" }, stageText(run)),
    bar(run),
    ...(mayStartRuns ? run.actions : []).map((action) =>
      h(
        "button",
        {
          type: "button",
          class: "link",
          "data-action": action,
          "aria-label": `${ACTION_TEXTS[action]}: ${title}`,
          onclick: () => actions.have(run, action),
        },
        ACTION_TEXTS[action],
      ),
    ),
  );
}

/** On a server without an engine. */
const onlyShown = ({ trouble }: Engine): HTMLElement =>
  h(
    "p",
    { class: "hint", role: "status" },
    ...withCode(
      `This server shows the map and runs nothing: ${trouble}. \`solmap run\` processes a downlink; \`solmap up\` processes and serves.`,
    ),
  );

function startButtons(
  kinds: readonly RunKind[],
  mayStartRuns: boolean,
  actions: RunActions,
  engine: Engine | null,
): HTMLElement {
  if (engine?.is_known === false) return onlyShown(engine);
  if (!mayStartRuns)
    return h("p", { class: "hint" }, "Sign in as an operator to start runs from here.");
  const buttons = kinds.map((kind) =>
    h(
      "button",
      {
        type: "button",
        class: "primary",
        "data-start": kind.kind,
        onclick: () => actions.start(kind),
      },
      kind.title.replace(/\.$/, ""),
    ),
  );
  return h("div", { class: "run-buttons" }, ...buttons);
}

export function runsPanel(
  known: Runs,
  kinds: readonly RunKind[],
  mayStartRuns: boolean,
  actions: RunActions,
  engine: Engine | null,
): HTMLElement {
  const waiting = known.requests.filter(({ state }) => state !== "taken").slice(0, 5);
  const reports = known.reports.map((report) =>
    h(
      "li",
      {},
      h(
        "button",
        {
          type: "button",
          class: "link",
          "data-report": report.scope,
          onclick: () => actions.openReport(report),
        },
        report.scope,
      ),
    ),
  );
  return h(
    "div",
    { class: "runs" },
    startButtons(kinds, mayStartRuns, actions, engine),
    ...waiting.map((request) => h("p", { class: "request" }, ...withCode(requestText(request)))),
    h("h2", {}, "Runs"),
    known.runs.length > 0
      ? h("ul", { class: "plain" }, ...known.runs.map((run) => row(run, mayStartRuns, actions)))
      : h("p", { class: "hint" }, "Nothing has run on this store yet."),
    h("h2", {}, "Quality of adjustments"),
    reports.length > 0
      ? h("ul", { class: "plain" }, ...reports)
      : h("p", { class: "hint" }, "No adjustment has been published yet."),
  );
}
