import { expect, test } from "vitest";
import { type ChartOptions, domains, keyed, type Series, valuesText } from "./chart-series";

const adjusted: Series = {
  name: "adjusted",
  colour: "red",
  xs: [0, 10, 20],
  ys: [1, null, 3],
  sigma: [0.1, null, 0.5],
};
const options: ChartOptions = {
  title: "profile",
  summary: "",
  x: { title: "distance", unit: "m", decimals: 1 },
  y: { title: "elevation", unit: "m", decimals: 2 },
  series: [adjusted, { ...adjusted, name: "telemetry", sigma: [], ys: [1, 2, 4] }],
};

test("the band has room on the axis", () => {
  const { x, y } = domains([adjusted]);
  expect(x).toEqual([0, 20]);
  expect(y[0]).toBeLessThan(0.9);
  expect(y[1]).toBeGreaterThan(3.5);
});

test("the value at the cursor is given with its uncertainty, or as not measured", () => {
  expect(valuesText(options, 20)).toBe("adjusted 3.0 ± 0.5 m, telemetry 4.00 m");
  expect(valuesText(options, 5)).toBe("adjusted not measured, telemetry 1.50 m");
});

test("arrow keys walk along the axis, other keys are left to the page", () => {
  expect(keyed("ArrowRight", null, [0, 200])).toBe(0);
  expect(keyed("ArrowRight", 5, [0, 200])).toBe(6);
  expect(keyed("PageDown", 50, [0, 200])).toBe(40);
  expect(keyed("End", 5, [0, 200])).toBe(200);
  expect(keyed("m", 5, [0, 200])).toBeUndefined();
});
