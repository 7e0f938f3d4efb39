import { expect, test } from "vitest";
import { tieTip, tipOf } from "./tip";

const TIE = { kind: "cross-site", residual_px: 0.4213, sigma_m: 0.0312, pairs: ["A", "B"] };

test("a tie point gives its kind, residual, uncertainty and images", () => {
  expect(tieTip(TIE)).toEqual({
    title: "tie point · cross-site",
    facts: ["residual 0.42 px (rms)", "σ of its place 0.03 m", "A", "B"],
  });
  expect(tieTip({}).facts).toEqual(["residual not known"]);
});

test("an image states why it has no partner, and a stop names its solution", () => {
  const layer = { kind: "pointing", title: "Pointing lines" };
  const image = { image: "2N1", sol: 155, instrument: "NAVCAM", eye: "left" };
  expect(tipOf(layer, image)).toEqual({ title: "2N1", facts: ["sol 155 · NAVCAM left"] });
  expect(tipOf(layer, { ...image, unpaired_because: "never sent" }).caution).toBe(
    "without partner: never sent",
  );
  expect(tipOf({ kind: "stops", title: "Stops" }, { solution: "adjusted" }).facts).toEqual([
    "adjusted",
  ]);
});
