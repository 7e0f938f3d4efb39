import { expect, test } from "vitest";
import { MISSION, PROJ4 } from "../../fixtures";
import { localMap } from "../../map/projection";
import type { MapPoint } from "../../server/records";
import { boundsOf } from "./drawn";
import { type Measurement, measurementsCsv, measurementsGeojson, profilesCsv } from "./export";
import { profileOptions } from "./ground-profile";
import { MODES } from "./modes";
import { withoutRepeats } from "./corners";
import { areaQuantities, lineQuantities, quantityText, zoneQuantities } from "./quantities";

const LAYER = { id: "mer2/dtm", kind: "dtm", digest: "0123", cell_m: 0.08 };
const FOUND = {
  map_length_m: 25,
  surface_length_m: 25.5,
  measured_share: 1,
  ends: {
    map_distance_m: 25,
    straight_m: 25.2,
    rise_m: -2.125,
    sigma_rise_m: 0.03,
    slope_deg: -4.86,
    sigma_slope_deg: 0.07,
    azimuth_deg: 36.87,
    true_azimuth_deg: 36.87,
  },
  layers: [LAYER],
};
const CORNERS: MapPoint[] = [
  [0, 0],
  [15, 20],
];
const [DISTANCE] = MODES;
if (!DISTANCE) throw new Error("there is no way to measure");
const ONE: Measurement = {
  number: 1,
  mode: DISTANCE,
  corners: CORNERS,
  found: { quantities: lineQuantities(FOUND, CORNERS), main: 0, layers: [LAYER] },
};

test("a quantity carries its unit and its uncertainty", () => {
  const of = (name: string) => ONE.found.quantities.find((one) => one.name === name);
  const text = (name: string) => quantityText(of(name) ?? { name, value: null, unit: "" });
  expect(text("length on the map")).toBe("25.00 ± 0.03 m");
  expect(text("rise")).toBe("−2.13 ± 0.03 m");
  expect(text("slope")).toBe("−4.86 ± 0.07°");
  expect(text("ground measured")).toBe("100 %");
  expect(quantityText({ name: "strike", value: null, unit: "°" })).toBe("–");
  expect(quantityText({ name: "rock", value: 0.00123, unit: "m³" })).toBe("0.00123 m³");
});

test("an area has the digits that the cells under its corners allow", () => {
  const square: MapPoint[] = [
    [0, 0],
    [20, 0],
    [20, 20],
    [0, 20],
  ];
  const found = {
    ...{ map_area_m2: 400, surface_area_m2: 404.1234, perimeter_m: 80, measured_share: 1 },
    ...{ elevation_mean_m: 0.01, elevation_min_m: -0.2, elevation_max_m: 0.3 },
    ...{ sigma_elevation_mean_m: 0.012, sigma_elevation_min_m: 0.06, sigma_elevation_max_m: null },
    layers: [{ ...LAYER, cell_m: 0.16 }],
  };
  // Every corner turns the area by half of the diagonal, 14.1 m, and is known to 16 cm / sqrt(12).
  const [flat, ground, perimeter, least, mean, most] = areaQuantities(found, square);
  expect(flat?.sigma).toBeCloseTo(2 * Math.sqrt(200) * (0.16 / Math.sqrt(12)), 9);
  expect(flat && quantityText(flat)).toBe("400.0 ± 1.3 m²");
  expect(ground && quantityText(ground)).toBe("404.1 ± 1.3 m²");
  expect(perimeter && quantityText(perimeter)).toBe("80.00 ± 0.13 m");
  // By the server's standard deviation, else by the cell.
  expect([least, mean, most].map((one) => one && quantityText(one))).toEqual([
    "−0.20 ± 0.06 m",
    "0.010 ± 0.012 m",
    "0.3 m",
  ]);
  const [sharp] = areaQuantities({ ...found, layers: [{ ...LAYER, cell_m: 0.01 }] }, square);
  expect(sharp && quantityText(sharp)).toBe("400.00 ± 0.08 m²");
  const [alone] = areaQuantities({ ...found, layers: [] }, square);
  expect(alone?.sigma).toBeNull();
});

test("a table has a line for every quantity and every corner", () => {
  const lines = measurementsCsv([ONE]).trim().split("\n");
  expect(lines).toHaveLength(1 + ONE.found.quantities.length + 2 * CORNERS.length);
  expect(lines).toContain("1,distance,rise,-2.125,0.03,m,mer2/dtm");
  expect(lines.at(-1)).toBe("1,distance,north of point 2,20,,m,");
});

test("GeoJSON is in degrees of Mars and names that system", () => {
  const local = localMap(MISSION);
  const text = measurementsGeojson([ONE], MISSION, local);
  const { crs, features, ...rest } = JSON.parse(text);
  expect(crs.properties.name).toBe("urn:ogc:def:crs:IAU:2015:49900");
  expect(rest["solmap:local_crs"]).toBe(PROJ4);
  const [, end] = features[0].geometry.coordinates;
  const [east, north] = local.fromLonLat(end);
  expect(Math.hypot(east - 15, north - 20)).toBeLessThan(1e-4); // nine decimals are 0.06 mm
  expect(features[0].properties["rise, m"]).toBe(-2.125);
});

test("an area is closed in GeoJSON", () => {
  const area = MODES.find(({ key }) => key === "area") ?? DISTANCE;
  const corners: MapPoint[] = [...CORNERS, [15, 0]];
  const text = measurementsGeojson([{ ...ONE, mode: area, corners }], MISSION, localMap(MISSION));
  const [ring] = JSON.parse(text).features[0].geometry.coordinates;
  expect(ring).toHaveLength(4);
  expect(ring[0]).toEqual(ring[3]);
});

const PROFILE = {
  length_m: 25,
  step_m: 12.5,
  slope_baseline_m: 0.5,
  distance_m: [0, 12.5, 25],
  east: [0, 7.5, 15],
  north: [0, 10, 20],
  elevation_m: [1, null, 3],
  sigma_m: [0.1, null, 0.2],
  slope_deg: [5, null, 6],
  slope_sigma_deg: [0.1, null, 0.1],
  source: [0, null, 0],
  layers: [LAYER],
};

test("stations of a profile keep their source, and gaps stay empty", () => {
  const text = profilesCsv([ONE, { ...ONE, number: 2, found: { ...ONE.found, profile: PROFILE } }]);
  expect(text.trim().split("\n").slice(1)).toEqual([
    "2,0,0,0,1,0.1,5,0.1,mer2/dtm,0123",
    "2,12.5,7.5,10,,,,,,",
    "2,25,15,20,3,0.2,6,0.1,mer2/dtm,0123",
  ]);
});

test("a profile is described in words", () => {
  expect(profileOptions(PROFILE, "elevation").summary).toBe(
    "From Elevation (DTM): Mission. Elevation 1.00 ± 0.10 m to 3.00 ± 0.20 m. 67 % measured; the band is one sigma.",
  );
  expect(profileOptions(PROFILE, "slope").series[0]?.sigma).toEqual([0.1, null, 0.1]);
});

test("the second click of a double-click is not a corner", () => {
  expect(
    withoutRepeats([
      [0, 0],
      [1, 2],
      [1, 2],
    ]),
  ).toEqual([
    [0, 0],
    [1, 2],
  ]);
});

test("a measurement is gone to by the box around it", () => {
  expect(boundsOf([...CORNERS, [-3, 4]])).toEqual([-3, 0, 15, 20]);
});

const ZONE = {
  unit: "degree",
  count: 100,
  measured_share: 0.5,
  mean: 12,
  std: 3,
  min: 1,
  max: 30,
  percentiles: { "5.0": 2, "50.0": 11, "95.0": 25 },
  classes: [],
  layers: [LAYER],
};

test("statistics carry the unit of the layer, and classes their shares", () => {
  const texts = zoneQuantities(ZONE).map((one) => `${one.name} ${quantityText(one)}`);
  expect(texts).toContain("mean 12.0°");
  expect(texts).toContain("median 11.0°");
  expect(texts.at(-1)).toBe("ground measured 50 %");
  const classes = [{ name: "rock", area_m2: 2, share: 0.25 }];
  expect(zoneQuantities({ ...ZONE, classes })).toEqual([
    { name: "rock", value: 25, resolution: 1, unit: "%" },
  ]);
});
