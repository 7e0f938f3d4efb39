import { expect, test } from "vitest";
import { areIn, isIn, solsTitle } from "./sols";

test("a range holds its first and its last sol", () => {
  expect([154, 155, 157, 158].map((sol) => isIn(sol, [155, 157]))).toEqual([
    ...[false, true, true, false],
  ]);
  expect([areIn([150, 156], [155, 157]), areIn([150, 160], [155, 157])]).toEqual([true, false]);
  expect([areIn([], [155, 157]), areIn([1], null)]).toEqual([true, true]);
});

test("a range has a title", () => {
  expect([solsTitle(null), solsTitle([3, 3]), solsTitle([3, 9])]).toEqual([
    ...["all sols", "sol 3", "sols 3–9"],
  ]);
});
