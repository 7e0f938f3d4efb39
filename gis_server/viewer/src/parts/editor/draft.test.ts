import { expect, test } from "vitest";
import type { Refined, Trial } from "../../server/ties";
import { EMPTY, planned, withFirst, withMeasured, withSecond, without, tieRequests } from "./draft";

const A = { image: "A", sample: 10, line: 20 };
const B = { image: "B", sample: 30, line: 40 };
const MEASURED: Refined = {
  found: true,
  said: null,
  sample: 30.4,
  line: 39.8,
  moved_px: 0.45,
  sigma_px: 0.04,
  correlation: 0.9,
};
const TRIAL = { ties: [] } as unknown as Trial;

test("a tie takes a pick in both images", () => {
  expect(planned(withFirst(EMPTY, A)).planned).toEqual([]);
  const draft = planned(withSecond(withFirst(EMPTY, A), B));
  expect(draft.planned).toHaveLength(1);
  expect([draft.first, draft.second]).toEqual([null, null]);
});

test("another first pick forgets the second", () => {
  expect(withFirst(withSecond(withFirst(EMPTY, A), B), { ...A, sample: 11 }).second).toBeNull();
});

test("a measured point replaces the picked one and brings its deviation, never below a tenth", () => {
  const draft = withMeasured(withSecond(withFirst(EMPTY, A), B), MEASURED);
  expect(draft.second).toMatchObject({ sample: 30.4, line: 39.8, sigma_px: 0.04 });
  const [request] = tieRequests(planned(draft));
  expect(request).toEqual({
    action: "add",
    first: A,
    second: { image: "B", sample: 30.4, line: 39.8 },
    sigma_px: 0.1,
  });
});

test("what was not found stays as it was picked, with the deviation of a person", () => {
  const picked = withSecond(withFirst(EMPTY, A), B);
  expect(withMeasured(picked, { ...MEASURED, found: false })).toBe(picked);
  expect(tieRequests(planned(picked))[0]).not.toHaveProperty("sigma_px");
});

test("the same tie is planned once, and a trial is forgotten when ties change", () => {
  const one = planned(withSecond(withFirst(EMPTY, A), B));
  const again = planned(withSecond(withFirst({ ...one, trial: TRIAL }, A), { ...B, line: 40.1 }));
  expect(again.planned).toHaveLength(1);
  expect(again.trial).toBeNull();
  expect(without({ ...one, trial: TRIAL }, 0)).toEqual(EMPTY);
});
