import { expect, test } from "vitest";
import { MISSION } from "../fixtures";
import type { MapPoint } from "../server/records";
import {
  COORDINATE_FORMATS,
  inFrames,
  lonLatText,
  MAP_ONLY,
  readCoordinates,
  type References,
} from "./coordinates";
import { localMap } from "./projection";

const local = localMap(MISSION);
const level = (turn: number) =>
  [
    [Math.sin(turn), Math.cos(turn), 0],
    [Math.cos(turn), -Math.sin(turn), 0],
    [0, 0, -1],
  ] as const;
const FRAMES = {
  sites: [{ site: 10, place: [100, 200, 0], map_from_site: level(0) }],
  stops: [
    { site: 10, drive: 64, place: [110, 205, 1], map_from_rover: level(Math.PI / 2) },
    { site: 11, drive: 0, place: [500, 500, 1], map_from_rover: level(0) },
  ],
} as unknown as NonNullable<References["frames"]>;
const TO: References = { local, bounds: MISSION.bounds, frames: FRAMES };
const ROCK: MapPoint = [10.5, 17.25];
const first = (text: string, to = TO) => readCoordinates(text, to)[0]?.point ?? [];
const [LON, LAT] = local.toLonLat(ROCK);
const west = 360 - LON;

function expectAt(text: string, [east, north]: MapPoint, digits = 2) {
  const [e = Number.NaN, n = Number.NaN] = first(text);
  expect(e, text).toBeCloseTo(east, digits);
  expect(n, text).toBeCloseTo(north, digits);
}

test.each([
  `${LAT} ${LON}`,
  `${LAT}, ${LON}`,
  `${LAT},${LON - 360}`,
  `${LON} ${LAT}`,
  `${-LAT}S ${LON}E`,
  `${-LAT} S, ${LON} E`,
  `S ${-LAT} E ${LON}`,
  `${-LAT}° S ${west}° W`,
  `${LON}E ${-LAT}S`,
  `lat ${LAT} lon ${LON}`,
  `latitude: ${LAT}, longitude: ${LON}`,
  `\u2212${-LAT}\u00b0, ${LON}\u00b0 E`,
])("%s is the rock, in degrees", (text) => expectAt(text, ROCK));

test.each([
  `14°34'09.12"S 175°28'22.44"E`,
  "14° 34′ 9.12″ S, 175° 28′ 22.44″ E",
  "14 34 9.12 S 175 28 22.44 E",
  "-14 34 9.12 175 28 22.44",
  "14:34:9.12S 175:28:22.44E",
  "14d34m9.12s S 175d28m22.44s E",
  "14°34.152'S 184°31.626'W",
])("%s is the lander, in degrees, minutes and seconds", (text) => expectAt(text, [0, 0]));

test.each([
  ["12.5, -3", [12.5, -3]],
  ["12.5 m, -3 m", [12.5, -3]],
  ["N -3 m, E 12.5 m", [12.5, -3]],
  ["N −3.00 m  E 12.50 m", [12.5, -3]],
  ["3 m S 12.5 m E", [12.5, -3]],
  ["east 12.5 north -3", [12.5, -3]],
  ["x -3 y 12.5", [12.5, -3]],
] as const)("%s are metres on the map", (text, point) => expect(first(text)).toEqual(point));

test("numbers that may be either are offered as both, what is near the mapped ground first", () => {
  const titles = (text: string) => readCoordinates(text, TO).map(({ title }) => title);
  expect(titles("-14.5689 175.4730")).toEqual([
    "−14.568900°, 175.473000° E",
    "east −14.57 m, north 175.47 m",
  ]);
  expect(titles("12.5 -3")).toEqual(["east 12.50 m, north −3.00 m"]); // the other side of Mars
  const [, far] = readCoordinates("-14 170", TO);
  expect(far?.detail).toMatch(/^latitude, longitude, 3\d\d km off the mapped ground$/);
  expect(readCoordinates("12.5 -3", MAP_ONLY)).toHaveLength(1);
});

test("coordinates of site frames and rover frames lie where the frames are", () => {
  expectAt("site 10: 5 -2", [98, 205], 9);
  expectAt("Site frame 10, x 5 y -2 z 0.3", [98, 205], 9);
  expectAt("10/64: 3 1", [113, 204], 9); // heading east, right is south
  expectAt("rover 10/64 3 1 0.2 m", [113, 204], 9);
  expectAt("site 10 drive 64: 3, 1", [113, 204], 9);
  expect(readCoordinates("site 12: 5 -2", TO)).toEqual([]);
  expect(readCoordinates("site 10 drive 64", TO)).toEqual([]);
  expect(readCoordinates("10/64", TO)).toEqual([]);
});

test.each(["", "12.5", "sol 12", "site 1", "95° S 10° E", "12 61 0 S 3 0 0 E", "1 2 3", "3N 4N"])(
  "%o is not a place",
  (text) => expect(readCoordinates(text, { ...TO, bounds: null })).toEqual([]),
);

test.each(COORDINATE_FORMATS)("what is shown as %s is read back", (format) => {
  for (const point of [ROCK, [-3000, 4000], [0, 0]] as const)
    expectAt(lonLatText(local.toLonLat(point), format, 8).join(" "), point);
});

test("seconds carry over", () => {
  expect(lonLatText([359.99999999, -0.99999999], "dms", 5)).toEqual([
    "1°00′00.00″ S",
    "360°00′00.00″ E",
  ]);
  expect(lonLatText([175.4729, -14.5692], "dms")).toEqual(["14°34′09.120″ S", "175°28′22.440″ E"]);
  expect(lonLatText([175.4729, -14.5692], "west")).toEqual(["−14.569200°", "184.527100° W"]);
});

test("a place is given in the frames of the nearest stop, and read back", () => {
  const readings = inFrames([113, 204], 0.5, FRAMES, 3);
  expect(readings).toEqual([
    ["site 10", "4.000, 13.000, −0.500 m"],
    ["rover 10/64", "3.000, 1.000, 0.500 m"],
  ]);
  for (const [frame, text] of readings) expectAt(`${frame}: ${text}`, [113, 204], 6);
  expect(inFrames([113, 204], null, FRAMES, 2)[1]).toEqual(["rover 10/64", "3.00, 1.00 m"]);
});
