import { expect, test } from "vitest";
import { clock } from "./light";

test.each([
  [14.5, "14:30"],
  [0, "00:00"],
  [24, "00:00"],
  [9.999, "10:00"],
])("%d hours are %s", (hours, text) => expect(clock(hours)).toBe(text));
