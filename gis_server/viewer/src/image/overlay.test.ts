import { expect, test } from "vitest";
import type { ImageTie } from "../server/network";
import { BLUNDER, colourOf, residualEnd, tieAt, tieText } from "./overlay";

const tie: ImageTie = {
  point: 7,
  kind: "cross-site",
  sample: 100,
  line: 50,
  residual_sample_px: 0.3,
  residual_line_px: -0.4,
  standardised: 1,
  status: "used",
  pairs: ["2NB"],
  place: [1, 2, 3],
  sigma_m: 0.1234,
};

test("a residual points from where the tie was measured to where it was computed", () => {
  expect(residualEnd(tie, 10)).toEqual([97, 54]);
  expect(residualEnd(tie, 0)).toBeNull();
  expect(residualEnd({ ...tie, residual_line_px: null }, 10)).toBeNull();
});

test("the nearest tie within reach is under the pointer", () => {
  const far = { ...tie, point: 8, sample: 104 };
  const viewport = { scale: 2, left: 0, top: 0 };
  expect(tieAt([tie, far], viewport, [207, 101])?.point).toBe(8);
  expect(tieAt([tie, far], viewport, [230, 101])).toBeNull();
});

test("what was set aside is red, whatever it joins", () => {
  expect(colourOf({ ...tie, status: "blunder" })).toBe(BLUNDER);
  expect(colourOf(tie)).not.toBe(colourOf({ ...tie, kind: "inter-stereo" }));
});

test("a tie point is described in words", () => {
  expect(tieText(tie)).toBe(
    "tie point 7, cross-site: residual 0.50 px, known to 0.12 m, also in 2NB",
  );
  expect(tieText({ ...tie, status: "blunder", pairs: [], sigma_m: null })).toBe(
    "tie point 7, cross-site, set aside: residual 0.50 px, in this pair alone",
  );
});
