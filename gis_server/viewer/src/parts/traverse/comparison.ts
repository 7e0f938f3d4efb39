/** Comparison of two solutions of the traverse: choice, table, vectors on the map, profile. */

import { h } from "../../page/dom";
import { saveFile } from "../../page/save";
import { ApiError } from "../../server/api";
import { network, type Solution, type TraverseAnswer } from "../../server/network";
import type { MapPoint } from "../../server/records";
import type { Context } from "../../session/context";
import { addPane } from "../../session/pane";
import {
  differencesCsv,
  differenceTable,
  solutionTitle,
  summaryText,
  TELEMETRY_NAME,
} from "./differences";
import { LinkedProfile } from "./linked-profile";
import { DifferenceVectors, FACTORS, vectorFactor } from "./vectors";

const LATEST = "latest";
const NONE = "No adjustment has been made yet: there is nothing to compare telemetry with.";

export class Comparison {
  readonly element = h("div", { class: "comparison" });
  private readonly vectors: DifferenceVectors;
  private profile: LinkedProfile | null = null;
  private readonly table = h("div");
  private solutions: readonly Solution[] = [];
  private answer: TraverseAnswer | null = null;
  private bySol = false;
  private hasVectors = false;
  private factor = 1;

  constructor(
    private readonly context: Context,
    private readonly zoomTo: (at: MapPoint) => void,
  ) {
    this.vectors = new DifferenceVectors(context.view.map);
    context.state.on("solutions", () => context.waiting.run(() => this.compare()));
    addPane(context, "traverse", {
      title: "Vertical profile of the traverse",
      side: "below",
      load: async () => {
        const profile = new LinkedProfile(context);
        this.profile = profile;
        if (this.answer) profile.draw(this.answer);
        const dispose = () => {
          profile.dispose();
          this.profile = null;
        };
        return { element: profile.element, dispose };
      },
    });
    context.signal.addEventListener("abort", () => this.vectors.dispose());
  }

  /** Requests the solutions and compares the chosen two. A mission without adjustment shows a message. */
  async load(): Promise<void> {
    try {
      this.solutions = await network.solutions(this.context.mission.mission);
      await this.compare();
    } catch (reason) {
      const isNone = reason instanceof ApiError && [404, 422].includes(reason.status ?? 0);
      if (!isNone) throw reason;
      this.answer = null;
      this.element.replaceChildren(h("p", { class: "hint" }, NONE));
      this.show();
    }
  }

  private async compare(): Promise<void> {
    const { mission, state } = this.context;
    const { solution, reference } = state.get("solutions");
    this.answer = await network.traverse(mission.mission, solution, reference);
    this.factor = vectorFactor(this.answer);
    this.draw(this.answer);
    this.show();
    this.profile?.draw(this.answer);
  }

  private choose(part: "solution" | "reference", value: string): void {
    const { state } = this.context;
    state.set("solutions", { ...state.get("solutions"), [part]: value });
  }

  private show(): void {
    this.vectors.show(this.hasVectors ? this.answer : null, this.factor);
  }

  private draw(answer: TraverseAnswer): void {
    const openProfile = () => this.context.state.set("traverse", true);
    const csv = () => saveFile("differences.csv", "text/csv", differencesCsv(answer));
    this.drawTable(answer);
    this.element.replaceChildren(
      this.selects(),
      h("p", { class: "summary" }, summaryText(answer)),
      this.switches(answer),
      h(
        "div",
        { class: "actions" },
        h(
          "button",
          { type: "button", class: "text profile", onclick: openProfile },
          "vertical profile",
        ),
        h("button", { type: "button", class: "text csv", onclick: csv }, "CSV"),
      ),
      this.table,
    );
  }

  private drawTable(answer: TraverseAnswer): void {
    const goTo = ({ place }: { place: readonly [number, number, number | null] }) =>
      this.zoomTo([place[0], place[1]]);
    this.table.replaceChildren(differenceTable(answer, this.bySol, goTo));
  }

  private selects(): HTMLElement {
    const chosen = this.context.state.get("solutions");
    const option = (value: string, title: string, chosen: string) =>
      h("option", { value, selected: value === chosen }, title);
    const named = (id: string) =>
      this.solutions.map((one) => option(one.id, solutionTitle(one, this.solutions), id));
    const solution = h(
      "select",
      { class: "solution", onchange: () => this.choose("solution", solution.value) },
      option(LATEST, "latest adjustment", chosen.solution),
      ...named(chosen.solution),
    );
    const reference = h(
      "select",
      { class: "reference", onchange: () => this.choose("reference", reference.value) },
      option(TELEMETRY_NAME, "telemetry", chosen.reference),
      ...named(chosen.reference),
    );
    return h(
      "div",
      { class: "solutions" },
      h("label", {}, h("span", {}, "solution"), solution),
      h("label", {}, h("span", {}, "against"), reference),
    );
  }

  private switches(answer: TraverseAnswer): HTMLElement {
    const bySol = h("input", {
      type: "checkbox",
      class: "by-sol",
      checked: this.bySol,
      onchange: () => {
        this.bySol = bySol.checked;
        this.drawTable(answer);
      },
    });
    const vectors = h("input", {
      type: "checkbox",
      class: "vectors",
      checked: this.hasVectors,
      onchange: () => {
        this.hasVectors = vectors.checked;
        this.show();
      },
    });
    const factor = h(
      "select",
      {
        "aria-label": "length of difference vectors",
        onchange: () => {
          this.factor = Number(factor.value);
          this.show();
        },
      },
      ...FACTORS.map((one) =>
        h("option", { value: one, selected: one === this.factor }, `× ${one}`),
      ),
    );
    return h(
      "div",
      { class: "switches" },
      h("label", {}, bySol, "by sol"),
      h("label", {}, vectors, "vectors on the map"),
      factor,
    );
  }
}
