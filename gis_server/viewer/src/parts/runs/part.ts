/** Runs: their progress and outcome, and requests for new ones. */

import "./runs.css";
import { h } from "../../page/dom";
import { mayAct } from "../../server/account";
import {
  type Engine,
  type Parameters,
  type Report,
  type Run,
  type RunAction,
  type RunKind,
  type RunRequest,
  type Runs,
  runs,
} from "../../server/runs";
import type { Context } from "../../session/context";
import { enginePanel } from "./deployments";
import { runsPanel } from "./panel";
import { advanced } from "./progress";
import { confirmation, startForm, valueText, whenText } from "./start";
import { statusIndicator } from "./status";

/** The engine's state changes without an event: it is requested again after this time. */
const POLL_MS = 20_000;
const CANCEL =
  "The processes of the run are ended. What exists is kept; a later run continues from there.";
const RESTART =
  "It runs again with the same parameters. Products that exist are not computed again: only what failed or was not reached is.";
const PAUSE = "No scheduled run of it begins from now on. A run in progress is not stopped.";
const RESUME = "Its scheduled runs begin again.";

export function runsPart(context: Context): void {
  const { page, account, events, waiting, mission } = context;
  const panel = page.addTab("runs");
  let known: Runs = { runs: [], requests: [], reports: [] };
  let kinds: readonly RunKind[] = [];
  let engine: Engine | null = null;
  const status = statusIndicator(context, () => page.showTab("runs"));

  const open = (run: Run) =>
    waiting.run(async () => {
      const { lines } = await runs.one(run.id);
      const text = lines.length > 0 ? lines.join("\n") : "The log is empty.";
      page.dialog(`${run.kind}: ${run.subject}`, h("pre", { class: "json" }, text));
    });
  const openReport = (report: Report) =>
    waiting.run(async () => {
      const srcdoc = await runs.report(report);
      const title = `Quality of ${report.scope}`;
      page.dialog(title, h("iframe", { class: "report", sandbox: "", title, srcdoc }));
    });
  const confirmed = async (request: Promise<RunRequest>) => {
    await request;
    page.closeDialog();
    waiting.run(load);
  };
  const start = (kind: RunKind, given: Parameters = { mission: mission.mission.split("-")[0] }) => {
    const title = kind.title.replace(/\.$/, "");
    const check = (parameters: Parameters) => {
      const { properties } = kind.parameters;
      const values = Object.entries(parameters).map(
        ([name, value]) => [properties[name]?.title ?? name, valueText(value)] as const,
      );
      const going = known.runs.filter(({ state }) => state === "running").length;
      const details = [kind.effect, ...(engine ? [whenText(engine, going)] : [])];
      const request = () => confirmed(runs.request(kind.kind, parameters));
      const back = () => start(kind, parameters);
      dialog(`${title}: confirm`, confirmation(details, values, "Start", request, back));
    };
    dialog(title, startForm(kind, given, check));
  };
  const dialog = (title: string, content: HTMLElement) => {
    page.closeDialog();
    page.dialog(title, content);
  };
  const have = (run: Run, action: RunAction) => {
    const [what, label] =
      action === "cancel" ? [CANCEL, "Cancel the run"] : [RESTART, "Retry what failed"];
    const values = Object.entries(run.parameters).map(
      ([name, value]) => [name, valueText(value)] as const,
    );
    const act = () => confirmed(runs.have(run.id, action));
    dialog(`${run.kind}: ${run.subject}`, confirmation([what], values, label, act));
  };
  const engineActions = {
    pause: (deployment: Engine["deployments"][number]) => {
      const [what, label] = deployment.is_paused ? [RESUME, "Resume"] : [PAUSE, "Pause"];
      const act = () => confirmed(runs.pause(deployment));
      dialog(deployment.name, confirmation([what], [], label, act));
    },
    cancelQueued: ({ flow_run, name }: Engine["queued"][number]) => {
      const act = () => confirmed(runs.have(flow_run, "cancel"));
      dialog(name, confirmation(["The run never begins."], [], "Cancel the run", act));
    },
  };
  const press = { isOn: false, isDrawingDue: false };
  const draw = () => {
    status(engine);
    press.isDrawingDue = press.isOn; // a button that is replaced while it is pressed is not clicked
    if (press.isOn) return;
    const mayRequest = engine?.is_known !== false && mayAct(account.value, "operator");
    const actions = { open, openReport, start, have };
    panel.replaceChildren(runsPanel(known, kinds, mayRequest, actions, engine));
    if (engine?.is_known) panel.append(enginePanel(engine, mayRequest, engineActions));
  };
  panel.addEventListener("pointerdown", () => (press.isOn = true));
  const released = () => {
    press.isOn = false;
    if (press.isDrawingDue) setTimeout(draw); // after the click
  };
  for (const kind of ["pointerup", "pointercancel"])
    window.addEventListener(kind, released, { signal: context.signal });
  const load = async () => {
    [known, engine] = await Promise.all([runs.all(), runs.engine()]);
    if (kinds.length === 0) kinds = await runs.kinds();
    draw();
  };
  const poll = async () => {
    const before = JSON.stringify({ ...engine, at: "" });
    engine = await runs.engine();
    if (JSON.stringify({ ...engine, at: "" }) !== before) draw();
  };
  const timer = setInterval(() => void poll().catch(() => undefined), POLL_MS);
  context.signal.addEventListener("abort", () => clearInterval(timer));

  account.changed.on(draw);
  events.serverEvent.on(({ kind, document }) => {
    if (kind === "requests.changed" && document.state === "refused")
      page.toast(`Refused: ${document.answer ?? "no reason given"}`);
    if (kind === "requests.changed" || kind === "engine.changed" || kind === "reload")
      waiting.run(load);
    if (kind !== "run.changed") return;
    const moved = document.state === "running" ? advanced(known.runs, document) : null;
    if (moved) {
      known = { ...known, runs: moved };
      draw();
    } else waiting.run(load);
  });
  waiting.run(load);
}
