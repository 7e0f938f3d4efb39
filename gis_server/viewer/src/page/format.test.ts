import { expect, test } from "vitest";
import { compact, eastOf, fixed, metres, northOf, scopeTitle, sols, unitSign } from "./format";

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

test("scopes are told in the field's words", () => {
  expect(scopeTitle("mer2-site0010-drive0064")).toBe("Site 10 · drive 64");
  expect(scopeTitle("mer2-sol0156")).toBe("Sol 156");
  expect(scopeTitle("mer2")).toBe("Mission");
});

test("sols are a range where they follow each other", () => {
  expect(sols([157, 155, 156])).toBe("sols 155–157");
  expect(sols([155, 160])).toBe("sols 155, 160");
  expect(sols([155])).toBe("sol 155");
});

test("degrees and metres are shown by their signs", () => {
  expect([unitSign("degree"), unitSign("m"), unitSign(null), unitSign("K")]).toEqual([
    "°",
    " m",
    "",
    " K",
  ]);
});

test("where a landing site is, in words", () => {
  expect([northOf(-14.5692), eastOf(175.4729)]).toEqual(["14.5692° S", "175.4729° E"]);
  expect([northOf(18.4446), eastOf(-5.52663)]).toEqual(["18.4446° N", "5.5266° W"]);
});
