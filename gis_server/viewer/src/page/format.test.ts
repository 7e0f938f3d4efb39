import { expect, test } from "vitest";
import {
  compact,
  digits,
  eastOf,
  fixed,
  measured,
  metres,
  northOf,
  scopeTitle,
  sigmaText,
  sols,
  unitSign,
} from "./format";

test("what was not measured is a dash", () => {
  expect(fixed(null, 2)).toBe("–");
  expect(compact(Number.NaN)).toBe("–");
});

test("negative numbers have a minus, and zero has none", () => {
  expect(fixed(-1.5, 2)).toBe("−1.50");
  expect(fixed(-0.001, 2)).toBe("0.00");
});

test.each([
  [0.005, "5 mm"],
  [0.02, "2 cm"],
  [0.64, "64 cm"],
  [40, "40 m"],
  [1234, "1.23 km"],
])("%d metres are %s", (value, text) => expect(metres(value)).toBe(text));

test.each([
  [12.3456, "12.35"],
  [1900.4, "1900"],
  [0.012345, "0.01235"],
  [-3, "−3"],
])("%d is shown as %s", (value, text) => expect(compact(value)).toBe(text));

test("scopes are given in the field's terms", () => {
  expect(scopeTitle("mer2-site0010-drive0064")).toBe("Site 10 · drive 64");
  expect(scopeTitle("mer2-sol0156")).toBe("Sol 156");
  expect(scopeTitle("mer2")).toBe("Mission");
});

test("sols are a range where they follow each other", () => {
  expect(sols([157, 155, 156])).toBe("sols 155–157");
  expect(sols([155, 160])).toBe("sols 155, 160");
  expect(sols([155])).toBe("sol 155");
});

test("units are shown by their signs", () => {
  const units = ["degree", "m", null, "K", "Wh/m2/sol"];
  expect(units.map((unit) => unitSign(unit))).toEqual(["°", " m", "", " K", " Wh/m² per sol"]);
});

test("where a landing site is, in words", () => {
  expect([northOf(-14.5692), eastOf(175.4729)]).toEqual(["14.5692° S", "175.4729° E"]);
  expect([northOf(18.4446), eastOf(-5.52663)]).toEqual(["18.4446° N", "5.5266° W"]);
});

test.each([
  [12.3456, 0.05, "12.35 ± 0.05 m"],
  [12.3456, 0.0149, "12.346 ± 0.015 m"], // the first digit is 1: two are given
  [12.3456, 0.0296, "12.35 ± 0.03 m"], // which rounds to 3: one is given
  [12.3456, 0.096, "12.35 ± 0.10 m"], // which rounds to 10
  [-0.004, 0.03, "0.00 ± 0.03 m"], // larger than the value
  [-2.125, 0.03, "−2.13 ± 0.03 m"],
  [1234.5, 140, "1230 ± 140 m"],
  [1234.5, 3200, "1000 ± 3000 m"],
  [1.5e12, 4e9, "1500000000000 ± 4000000000 m"],
  [1, 2e-9, "1.0000000000 ± 0.0000000020 m"],
])("%d with a standard deviation of %d is %s", (value, sigma, text) =>
  expect(measured(value, "m", sigma)).toBe(text),
);

test.each([[0], [Number.NaN], [null], [undefined], [Number.POSITIVE_INFINITY], [-0.1]])(
  "a standard deviation of %s is none: digits are those of the cell",
  (sigma) => {
    expect(measured(12.3456, "m", sigma, 0.16)).toBe("12.3 m");
    expect(measured(12.3456, "m", sigma, 0.02)).toBe("12.35 m");
    expect(measured(12.3456, "m", sigma, 20)).toBe("12 m");
    expect(measured(12.3456, "degree", sigma)).toBe("12.3°");
    expect(sigmaText(sigma)).toBe("–");
  },
);

test("what was not measured has no standard deviation either", () => {
  expect(measured(Number.NaN, "m", 0.1)).toBe("–");
  expect(measured(null, "m", 0.1)).toBe("–");
});

test("a value without its standard deviation has the same digits", () => {
  expect([digits(12.3456, 0.05), sigmaText(0.05), sigmaText(0.0123, "degree")]).toEqual([
    "12.35",
    "0.05 m",
    "0.012°",
  ]);
});
