/** Runs: what goes on, how far it is and how it ended; new ones are asked for here. */

import "./runs.css";
import { h } from "../../page/dom";
import { mayAct } from "../../server/account";
import { type Report, type Run, type Runs, runs, type Wish } from "../../server/runs";
import type { Context } from "../../session/context";
import { runsPanel } from "./panel";
import { advanced } from "./progress";

export function runsPart(context: Context): void {
  const { page, account, signals, waiting, mission } = context;
  const panel = page.addTab("runs", "Runs");
  let known: Runs = { runs: [], requests: [], reports: [] };

  const open = (run: Run) =>
    waiting.run(async () => {
      const { lines } = await runs.one(run.id);
      const text = lines.length > 0 ? lines.join("\n") : "It has said nothing.";
      page.dialog(`${run.kind}: ${run.subject}`, h("pre", { class: "json" }, text));
    });
  const openReport = (report: Report) =>
    waiting.run(async () => {
      const srcdoc = await runs.report(report);
      const title = `Quality of ${report.scope}`;
      page.dialog(title, h("iframe", { class: "report", sandbox: "", title, srcdoc }));
    });
  const ask = (wish: Wish) =>
    waiting.run(async () => {
      await runs.ask(wish, wish === "downlink" ? null : mission.mission);
      await load();
    });
  const draw = () =>
    panel.replaceChildren(
      runsPanel(known, mayAct(account.value, "operator"), { open, openReport, ask }),
    );
  const load = async () => {
    known = await runs.all();
    draw();
  };

  account.changed.on(draw);
  signals.happened.on(({ kind, document }) => {
    if (kind === "requests.changed" || kind === "reload") waiting.run(load);
    if (kind !== "run.changed") return;
    const moved = document.state === "running" ? advanced(known.runs, document) : null;
    if (moved) {
      known = { ...known, runs: moved };
      draw();
    } else waiting.run(load);
  });
  waiting.run(load);
}
