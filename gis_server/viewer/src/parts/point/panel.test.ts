import { expect, test } from "vitest";
import { byScope, elevationText, valueText } from "./panel";
import { type Identified, imagesAt, propertiesOf } from "../../server/records";

const NOTHING: Identified = {
  east: 0,
  north: 0,
  lon: 175.4729,
  lat: -14.5692,
  elevation_m: null,
  elevation_sigma_m: null,
  layers: [],
  features: [],
};

test("an image sees the point if its footprint holds it, not if its pointing line passes by", () => {
  const feature = (kind: string, image: string) => ({ kind, properties: { image, sol: 1 } });
  const features = [
    feature("footprints", "A"),
    feature("pointing", "B"),
    feature("footprints", "A"),
  ];
  expect(imagesAt({ ...NOTHING, features })).toEqual(["A"]);
});

test("elevation is given with its standard deviation, or as having none", () => {
  expect(elevationText(NOTHING)).toBe("not measured");
  expect(elevationText({ ...NOTHING, elevation_m: -1.5 })).toBe("−1.50 m");
  expect(elevationText({ ...NOTHING, elevation_m: 2, elevation_sigma_m: 0.01 })).toBe(
    "2.000 ± 0.010 m",
  );
});

test("a value carries its unit", () => {
  const layer = {
    ...{ id: "a", kind: "slope", scope: "mer2", title: "", label: null },
    ...{ sigma: null, cell_m: 0.16 },
  };
  expect(valueText({ ...layer, value: 12.3456, unit: "degree" })).toBe("12.3°");
  expect(valueText({ ...layer, value: 12.3456, unit: "degree", sigma: 0.3 })).toBe("12.3 ± 0.3°");
  expect(valueText({ ...layer, kind: "dtm", value: 12.3456, unit: "m" })).toBe("12.3 m");
  expect(valueText({ ...layer, value: null, unit: "degree" })).toBe("–");
  expect(valueText({ ...layer, value: 3, unit: null, label: "2N151760231" })).toBe("2N151760231");
});

test("layers are listed by what they are about", () => {
  const layer = (scope: string, kind: string) => ({
    ...{ id: `${scope}/${kind}`, scope, kind, title: "", label: null, value: 1, unit: null },
    ...{ sigma: null, cell_m: null },
  });
  const layers = [layer("b", "dtm"), layer("a", "dtm"), layer("b", "slope")];
  expect(byScope(layers).map(([scope, found]) => [scope, found.map(({ kind }) => kind)])).toEqual([
    ["b", ["dtm", "slope"]],
    ["a", ["dtm"]],
  ]);
});

test("properties are found where GeoJSON has them, and beside", () => {
  expect(propertiesOf({ kind: "stops", properties: { stop: "a" } })).toEqual({
    kind: "stops",
    stop: "a",
  });
});
