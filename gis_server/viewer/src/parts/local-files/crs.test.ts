import { expect, test } from "vitest";
import { MISSION } from "../../fixtures";
import { localMap } from "../../map/projection";
import type { Bounds } from "../../server/records";
import { crsNamed, crsOf, LOCAL, type Target } from "./crs";
import { geojson } from "./read";

const TARGET: Target = { mission: MISSION, local: localMap(MISSION) };
const UNTIED: Target = { ...TARGET, mission: { ...MISSION, crs: { wkt: "LOCAL", proj4: null } } };
const { longitude, latitude } = MISSION.landing;
const SPHERE = "+R=3396190 +no_defs";
/** Metres a degree on the sphere. */
const DEG_M = (Math.PI / 180) * 3396190;

const geographic = (name: string, a: number, flattening: number) =>
  `GEOGCS["${name}",DATUM["D",SPHEROID["S",${a},${flattening}]],PRIMEM["P",0],UNIT["Degree",0.0174532925199433]]`;
const local = (lat: number) =>
  `PROJCS["local",${geographic("Mars", 3396190, 0)},PROJECTION["Orthographic"],PARAMETER["latitude_of_origin",${lat}],PARAMETER["central_meridian",${longitude}],PARAMETER["false_easting",0],PARAMETER["false_northing",0],UNIT["metre",1]]`;

test("degrees of Mars are placed by the local map, whatever their turn", () => {
  const crs = crsOf(geographic("GCS_Mars_2015_-_Sphere_Ocentric", 3396190, 0), TARGET);
  const [east, north] = crs.toMap([longitude, latitude + 0.001]);
  expect([east, north]).toEqual([expect.closeTo(0, 6), expect.closeTo(0.001 * DEG_M, 3)]);
  const [other] = crs.toMap([longitude - 360, latitude]);
  expect(other).toBeCloseTo(0, 6);
});

test("planetographic latitudes become planetocentric", () => {
  const crs = crsNamed("urn:ogc:def:crs:IAU:2015:49901", [0, 0, 0, 0], TARGET);
  const graphic =
    (Math.atan(Math.tan((latitude * Math.PI) / 180) * (3396190 / 3376200) ** 2) * 180) / Math.PI;
  const [east, north] = crs.toMap([longitude, graphic]);
  expect([east, north]).toEqual([expect.closeTo(0, 6), expect.closeTo(0, 5)]);
  expect(crs.fromMap([0, 0])[1]).toBeCloseTo(graphic, 9);
});

test("the local map itself is left as it is; that of another site is not", () => {
  expect(crsOf(local(latitude), TARGET)).toBe(LOCAL);
  const other = crsOf(local(latitude + 0.01), TARGET);
  const [, north = 0] = other.toMap([0, 0]);
  expect(north).toBeCloseTo(0.01 * DEG_M, 1);
});

test("projected maps of Mars go both ways", () => {
  const crs = crsOf(`+proj=eqc +lat_ts=0 +lon_0=180 +units=m ${SPHERE}`, TARGET);
  const place = [(longitude - 180) * DEG_M + 10, latitude * DEG_M + 20];
  const [east = 0, north = 0] = crs.toMap(place);
  expect(north).toBeCloseTo(20, 2);
  expect(east).toBeCloseTo(10 * Math.cos((latitude * Math.PI) / 180), 2);
  const back = crs.fromMap([east, north]);
  expect(back).toEqual(place.map((metres) => expect.closeTo(metres, 4)));
});

test("the Earth is refused, and so is what is not understood", () => {
  const earth = geographic("WGS 84", 6378137, 298.257223563);
  expect(() => crsOf(earth, TARGET)).toThrow(/in WGS 84, on a body of 6378 km.*map is of Mars/);
  expect(() => crsOf("PROJCS[nonsense", TARGET)).toThrow(/coordinate system is not understood/);
  expect(() => crsOf("EPSG:99999", TARGET)).toThrow(/coordinate system is not understood/);
});

test("numbers without a system are degrees near the site, or metres near the ground", () => {
  const near: Bounds = [longitude - 0.1, latitude - 0.1, longitude + 0.1, latitude + 0.1];
  expect(crsNamed(null, near, TARGET).isDegrees).toBe(true);
  expect(crsNamed("urn:ogc:def:crs:OGC:1.3:CRS84", near, TARGET).isDegrees).toBe(true);
  expect(crsNamed(null, [-30, -30, 30, 30], TARGET).isLocal).toBe(true);
  expect(() => crsNamed(null, [13, 52, 14, 1e6], TARGET)).toThrow(/neither degrees/);
});

test("a map that is not tied to the lander takes its own metres only", () => {
  expect(crsOf("LOCAL", UNTIED)).toBe(LOCAL);
  const mars = geographic("Mars", 3396190, 0);
  expect(() => crsOf(mars, UNTIED)).toThrow(/not tied to the lander/);
});

test("geometry collections are split into their members, features without geometry are omitted", () => {
  const point = { type: "Point", coordinates: [1, 2, 3] };
  const features = [
    { type: "Feature", geometry: { type: "GeometryCollection", geometries: [point, point] } },
    { type: "Feature", geometry: null },
  ];
  const text = JSON.stringify({ type: "FeatureCollection", features });
  expect(geojson("a", text, TARGET).features.map(({ geometry }) => geometry)).toEqual([
    point,
    point,
  ]);
  expect(() => geojson("a", "{", TARGET)).toThrow("it is not JSON");
  expect(() => geojson("a", "[]", TARGET)).toThrow(/not GeoJSON/);
});
