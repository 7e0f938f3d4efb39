import { getPointResolution } from "ol/proj";
import { expect, test } from "vitest";
import { MISSION, PROJ4 } from "../fixtures";
import { localMap, ProjectionError, planeOf } from "./projection";

const local = localMap(MISSION);

// Made with PROJ 9.5.1 on the sphere of 3396190 m; two implementations agree to 1e-11 degrees.
const KNOWN = [
  { name: "the lander", at: [0, 0], lonLat: [175.4729, -14.5692] },
  { name: "site 67", at: [2354.612872, -1075.024236], lonLat: [175.513946898634, -14.58733273008] },
  { name: "site 138", at: [3104.650165, -2034.054174], lonLat: [175.527025941, -14.603509503] },
] as const;

test.each(KNOWN)("$name lies where PROJ puts it", ({ at, lonLat }) => {
  const [lon, lat] = local.toLonLat(at);
  expect(lon).toBeCloseTo(lonLat[0], 8); // the known degrees have nine decimals
  expect(lat).toBeCloseTo(lonLat[1], 8);
});

test.each(KNOWN)("$name comes back to a tenth of a millimetre", ({ at }) => {
  const [east, north] = local.fromLonLat(local.toLonLat(at));
  expect(east).toBeCloseTo(at[0], 4);
  expect(north).toBeCloseTo(at[1], 4);
});

test("the local radius moves a place seven kilometres away by metres", () => {
  const crs = { wkt: "", proj4: PROJ4.replace("3396190", "3393000") };
  const [lon] = localMap({ ...MISSION, crs }).toLonLat([5000, 0]);
  const [iau] = local.toLonLat([5000, 0]);
  const metres = ((lon - iau) * Math.PI * 3393000 * Math.cos((14.5692 * Math.PI) / 180)) / 180;
  expect(metres).toBeCloseTo(5000 * (3396190 / 3393000 - 1), 1);
});

test("a metre of the map is a metre, not 1.88 of them", () => {
  expect(getPointResolution(local.projection, 0.25, [1234, -567])).toBe(0.25);
  expect(getPointResolution(local.projection, 0.25, [1234, -567], "m")).toBe(0.25);
});

test("longitudes run from 0 to 360 degrees", () => {
  const opportunity = PROJ4.replace("175.4729", "-5.5266");
  const [lon] = localMap({ ...MISSION, crs: { wkt: "", proj4: opportunity } }).toLonLat([0, 0]);
  expect(lon).toBeCloseTo(354.4734, 9);
});

test("a map that is not tied to the lander has no longitude and latitude", () => {
  const untied = localMap({ ...MISSION, crs: { wkt: "", proj4: null } });
  expect(untied.toLonLat([5, 6])).toEqual([Number.NaN, Number.NaN]);
  expect(untied.projection.getUnits()).toBe("m");
});

test("the other side of the planet has no place on the map", () => {
  expect(local.fromLonLat([355.4729, 14])).toEqual([Number.NaN, Number.NaN]);
  expect(local.toLonLat([3396191, 0])[1]).toBeNaN();
});

test("a plane that would be drawn wrong is refused", () => {
  expect(() => planeOf(`${PROJ4} +k_0=0.999`)).toThrow(ProjectionError);
  expect(() => planeOf(PROJ4.replace("ortho", "stere"))).toThrow(
    /not a plane that the viewer supports/,
  );
  expect(() => planeOf(PROJ4.replace("+R=3396190", "+ellps=WGS84"))).toThrow(/no number as \+R/);
});
