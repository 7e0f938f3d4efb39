import { expect, test } from "vitest";
import type { Run } from "../../server/runs";
import { advanced, durationText, requestText, share, stageText } from "./progress";

const RUN: Run = {
  id: "a",
  kind: "downlink",
  subject: "inbox",
  state: "running",
  started_at: "2026-11-22T01:00:00.000+00:00",
  changed_at: "2026-11-22T01:00:30.000+00:00",
  ended_at: null,
  stage: "match pairs",
  done: 3,
  total: 12,
  lines: [],
  parameters: {},
  actions: [],
};

test("progress is a share of the stage", () => {
  expect(share(RUN)).toBe(0.25);
  expect(share({ done: 0, total: 0 })).toBeNull();
  expect(stageText(RUN)).toBe("match pairs, 3 of 12");
  expect(stageText({ ...RUN, stage: null })).toBe("starting");
  expect(stageText({ ...RUN, state: "succeeded" })).toBe("");
  expect(stageText({ ...RUN, state: "lost" })).toContain("the next run continues");
});

test("time goes on while a run does, and stops with it", () => {
  const at = (text: string) => Date.parse(text);
  expect(durationText(RUN, at("2026-11-22T01:00:45+00:00"))).toBe("45 s");
  expect(durationText(RUN, at("2026-11-22T03:05:00+00:00"))).toBe("2 h 5 min");
  const ended = { ...RUN, ended_at: "2026-11-22T01:04:10+00:00" };
  expect(durationText(ended, at("2026-11-23T00:00:00+00:00"))).toBe("4 min");
});

test("an event advances its run and no other; for an unknown run the list is requested", () => {
  const other = { ...RUN, id: "b" };
  const event = { ...RUN, stage: "adjust", done: 1, total: 2 };
  expect(advanced([RUN, other], event)).toEqual([event, other]);
  expect(advanced([other], event)).toBeNull();
});

test("requests name the person, the run and its result", () => {
  const request = {
    id: 1,
    kind: "region",
    mission: "MER2",
    author: "Ann",
    at: "",
    state: "waiting",
    answer: null,
    parameters: {},
  } as const;
  expect(requestText(request)).toBe(
    "region of MER2, requested by Ann: waits for `solmap up` to take it",
  );
  expect(requestText({ ...request, state: "refused", answer: "no inbox" })).toContain("no inbox");
});
