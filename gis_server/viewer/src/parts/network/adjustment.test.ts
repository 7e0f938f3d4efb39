import { expect, test } from "vitest";
import { adjustmentFacts } from "./adjustment";

const ADJUSTMENT = {
  converged: true,
  iterations: 4,
  sigma0: 0.9712,
  redundancy: 3200,
  pairs: 30,
  ties: { "intra-stereo": 1812, "inter-stereo": 240, "cross-site": 43 },
  blunders: 1,
  control: 0,
  before: { "cross-site": { comparisons: 43, mean_2d_px: 65.2, mean_3d_m: 3.128 } },
  after: { "cross-site": { comparisons: 43, mean_2d_px: 0.42, mean_3d_m: 0.0312 } },
  message: "",
};
const stop = { stop: "a", label: "1/2", sols: [155], pairs: 15, held_by: "", weak: [] };
const stops = [
  { ...stop, place: [0, 0, 0], is_tied: true },
  { ...stop, place: [1, 0, 0], is_tied: true },
] as const;

test("the adjustment is described in words and with units", () => {
  expect(Object.fromEntries(adjustmentFacts({ stops, adjustment: ADJUSTMENT }))).toEqual({
    network: "2 stops, 30 pairs",
    "tie points used": "1,812 within pairs, 240 between pairs, 43 between stops",
    blunders: "1 observation set aside",
    "σ₀": "0.971 (1: stated standard deviations are true)",
    "stops differ by": "3.1 m, 65 px → 3.1 cm, 0.42 px",
    control: "",
    remark: "",
  });
});

test("stops without common points differ by nothing known", () => {
  const adjustment = { ...ADJUSTMENT, before: {}, after: {} };
  const rows = Object.fromEntries(adjustmentFacts({ stops, adjustment }));
  expect(rows["stops differ by"]).toBe("");
});
