import Feature from "ol/Feature";
import Point from "ol/geom/Point";
import { expect, test } from "vitest";
import { drawTie, NO_RESIDUAL, residualClass, RESIDUALS } from "./tie-style";

const tie = (residual_px?: number | null) =>
  drawTie(new Feature({ geometry: new Point([0, 0]), residual_px }));

test("a residual belongs to the class that begins with it", () => {
  const titles = [0, 0.0299, 0.03, 0.3, 2.999, 3, 26.5].map((px) => residualClass(px).title);
  expect(titles).toEqual([
    "below 0.03 px",
    "below 0.03 px",
    "0.03 to 0.1 px",
    "0.3 to 1 px",
    "1 to 3 px",
    "3 px and more",
    "3 px and more",
  ]);
});

test("a tie point with an unknown residual is distinguished from one with a small residual", () => {
  expect([null, undefined, Number.NaN].map(residualClass)).toEqual(Array(3).fill(NO_RESIDUAL));
  expect(tie(null)).not.toBe(tie(0));
});

test("colours differ, and larger residuals lie above smaller ones", () => {
  expect(new Set(RESIDUALS.map(({ colour }) => colour)).size).toBe(RESIDUALS.length);
  const order = [0.01, 0.05, 0.2, 0.5, 2, 9].map((px) => tie(px)?.getZIndex() ?? -1);
  expect(order).toEqual([...order].sort((a, b) => a - b));
  expect(new Set(order).size).toBe(order.length);
});
