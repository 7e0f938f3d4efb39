import { expect, test } from "vitest";
import { clock, DARK, formatLight, formatSky, parseLight, parseSky, type Sky } from "./light";

test.each(["", "relief", "relief*0.35,tilt:-3", "relief,shadow,tilt:5", "shadow,slope:12.5"])(
  "%s comes back",
  (text) => expect(formatLight(parseLight(text))).toBe(text),
);

test("what is not understood shows nothing", () => {
  expect(parseLight(null)).toEqual(DARK);
  expect(parseLight("rain,tilt:x")).toEqual(DARK);
});

test.each<[string, Sky]>([
  ["sol:156,14.5", { by: "time", sol: 156, hours: 14.5 }],
  ["293.1,20.5", { by: "hand", sun: { azimuthDeg: 293.1, elevationDeg: 20.5 } }],
])("%s is a sky", (text, sky) => {
  expect(parseSky(text)).toEqual(sky);
  expect(formatSky(sky)).toBe(text);
});

test.each([null, "", "sol:1", "sol:1,25", "10", "1,100", "a,b", "1,2,3"])("%s is none", (text) =>
  expect(parseSky(text)).toBeNull(),
);

test.each([
  [14.5, "14:30"],
  [0, "00:00"],
  [24, "00:00"],
  [9.999, "10:00"],
])("%d hours are %s", (hours, text) => expect(clock(hours)).toBe(text));
