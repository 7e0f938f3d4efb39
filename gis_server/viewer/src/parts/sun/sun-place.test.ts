import { expect, test } from "vitest";
import {
  hoursOf,
  julianDate,
  julianOf,
  momentOf,
  seasonAt,
  solarDays,
  solsBegin,
  utc,
} from "./mars-time";
import { daylight, sunAt, sunOver } from "./sun-place";

/** Landing points (config/landing_sites.toml); the labels count solar time there, at any distance of the rover. */
const SPIRIT = { latitude: -14.5692, longitude: 175.4729 };
const OPPORTUNITY = { latitude: -1.9462, longitude: 354.4734 };
const CURIOSITY = { latitude: -4.5895, longitude: 137.4417 };

/**
 * Labels of the mission archive: SOLAR_LONGITUDE, LOCAL_TRUE_SOLAR_TIME, and SOLAR_AZIMUTH and SOLAR_ELEVATION of
 * SITE_DERIVED_GEOMETRY_PARMS (the sign of elevations differs between labels and is left out here). One label of the
 * eight is left out: the azimuth of NLA_399621413EDR contradicts its own solar time by 80 degrees.
 */
const LABELS = [
  ["2n292280938eff", SPIRIT, "2009-04-06T08:48:13.468", "11:23:54", 241.474, 131.496, 78.801],
  ["2n295043924ffl", SPIRIT, "2009-05-08T08:17:37.990", "14:00:40", 261.757, 245.475, 59.935],
  ["2p295043688ffl", SPIRIT, "2009-05-08T08:13:41.867", "13:56:50", 261.755, 245.038, 60.7757],
  ["1p216067135edn", OPPORTUNITY, "2006-11-06T06:34:10.452", "11:41:48", 131.275, 12.0394, 68.8914],
  [
    "1F490747543EFF",
    OPPORTUNITY,
    "2015-07-21T10:40:33.760Z",
    "13:22:42",
    16.0331,
    293.088,
    67.5949,
  ],
  [
    "1N491020376ILF",
    OPPORTUNITY,
    "2015-07-24T14:28:03.539Z",
    "15:09:38",
    17.5319,
    281.703,
    41.7863,
  ],
  [
    "1P491287702ILF",
    OPPORTUNITY,
    "2015-07-27T16:43:46.110Z",
    "15:27:13",
    18.9945,
    281.583,
    37.3884,
  ],
  [
    "1F483288473EFF",
    OPPORTUNITY,
    "2015-04-26T02:37:16.685Z",
    "12:25:27",
    332.109,
    213.273,
    78.5822,
  ],
  ["NLA_399620372", CURIOSITY, "2012-08-30T17:42:02.671", "12:19:19", 163.553, 337.334, 77.4687],
  ["NLB_517261274EDR", CURIOSITY, "2016-05-23T08:02:09.959", "16:17:54", 156.996, 282.68, 24.2059],
] as const;

/** Angle between two places in the sky, degrees. */
function apart(
  a: { azimuthDeg: number; elevationDeg: number },
  b: { azimuthDeg: number; elevationDeg: number },
): number {
  const rad = Math.PI / 180;
  const [e1, e2] = [a.elevationDeg * rad, b.elevationDeg * rad];
  const turn = (a.azimuthDeg - b.azimuthDeg) * rad;
  const cosine = Math.sin(e1) * Math.sin(e2) + Math.cos(e1) * Math.cos(e2) * Math.cos(turn);
  return Math.acos(Math.min(1, cosine)) / rad;
}

test.each(LABELS)("%s: the season is the label's", (_, __, time, ___, ls) => {
  expect(seasonAt(julianDate(utc(time))).lsDeg).toBeCloseTo(ls, 1);
});

test.each(LABELS)("%s: the solar time is the label's", (_, site, time, solar) => {
  const minutes = 60 * (sunAt(site, utc(time)).hours - (hoursOf(solar) ?? Number.NaN));
  expect(Math.abs(minutes)).toBeLessThan(0.1); // 6 s; the labels round to one
});

test.each(LABELS)("%s: the sun is where the label states", (_, site, __, solar, ls, az, el) => {
  const sun = sunOver(site, ls, hoursOf(solar) ?? Number.NaN);
  expect(apart(sun, { azimuthDeg: az, elevationDeg: el })).toBeLessThan(0.01); // degrees; 0.005 were measured
});

test("the values of Mars24 for the epoch of its example", () => {
  // Mars24's worked example: 2000-01-06 00:00:00 UTC has Ls 277.18758 and EOT -5.18774 degrees.
  const { lsDeg, equationDeg } = seasonAt(julianDate(utc("2000-01-06T00:00:00")));
  expect(lsDeg).toBeCloseTo(277.18758, 3);
  expect(equationDeg).toBeCloseTo(-5.18774, 3);
});

test("moments and solar days are each other's inverse", () => {
  const moment = utc("2016-05-23T08:02:09");
  const days = solarDays(julianDate(moment), 137.44);
  expect(julianOf(days, 137.44)).toBeCloseTo(julianDate(moment), 6);
  expect(Math.abs(momentOf(julianDate(moment)).getTime() - moment.getTime())).toBeLessThan(2);
});

test("sols are counted as images of the mission count them", () => {
  const images = [
    { sol: 1869, start_time: "2009-04-06T08:48:13.468", local_solar_time: "11:23:54" },
    { sol: 1900, start_time: "2009-05-08T08:17:37.990", local_solar_time: "14:00:40" },
    { sol: 7, start_time: null, local_solar_time: "14:00:40" },
  ];
  const begin = solsBegin(images, SPIRIT.longitude);
  expect(begin).not.toBeNull();
  const { moment, lsDeg } = daylight(SPIRIT, begin ?? 0, 1869, 11 + 23.9 / 60);
  expect(Math.abs(moment.getTime() - utc("2009-04-06T08:48:13").getTime())).toBeLessThan(240e3);
  expect(lsDeg).toBeCloseTo(241.474, 1);
  // The mission began on sol 1 (sol 0 has no clock of its own): Spirit landed on 2004-01-04, 04:35 UTC.
  const landed = daylight(SPIRIT, begin ?? 0, 1, 14)
    .moment.toISOString()
    .slice(0, 10);
  expect(["2004-01-03", "2004-01-04", "2004-01-05"]).toContain(landed);
  expect(solsBegin([], 0)).toBeNull();
});

test("at noon the sun is in the meridian, in the morning in the east", () => {
  expect(sunOver(SPIRIT, 90, 12).azimuthDeg).toBeCloseTo(0, 6);
  expect(sunOver(SPIRIT, 90, 12).elevationDeg).toBeCloseTo(90 - 25.19 - 14.736, 2);
  expect(sunOver(SPIRIT, 0, 8).azimuthDeg).toBeLessThan(100);
  expect(sunOver(SPIRIT, 0, 16).azimuthDeg).toBeGreaterThan(260);
});

test.each([
  ["12:10:05", 12 + 10 / 60 + 5 / 3600],
  ["Sol-00025M13:05:30", 13 + 5 / 60 + 30 / 3600],
])("%s is a time", (text, hours) => expect(hoursOf(text)).toBeCloseTo(hours, 9));

test("a text that is not a time gives none", () => {
  expect([hoursOf(null), hoursOf("noon")]).toEqual([null, null]);
});
