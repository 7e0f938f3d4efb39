import { expect, test } from "vitest";
import { formatPoints, parsePoints } from "./link-points";

test("places in a link have millimetres", () => {
  const text = formatPoints([
    [0.12345, -3],
    [4, 5],
  ]);
  expect(text).toBe("0.123,-3;4,5");
  expect(parsePoints(text)).toEqual([
    [0.123, -3],
    [4, 5],
  ]);
});

test.each(["", "1", "1,2,3", "1,a", "1,2;"])("%s is not a place", (text) => {
  expect(parsePoints(text)).toBeNull();
});
