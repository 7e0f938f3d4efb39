import { expect, test } from "vitest";
import { PLAIN } from "../map/raster-style";
import { formatPermalink, parsePermalink, unreadable } from "./permalink";

test("a link records what was on the screen", () => {
  const link = {
    mission: "MER2",
    place: { east: 12.5, north: -3.25, resolution: 0.02, rotationDeg: 45 },
    on: new Map([
      ["mer2/stops", { opacity: 1, style: null, blend: "multiply" }],
      ["mer2-site0010-drive0064/slope", { opacity: 0.35, style: null, blend: null }],
      ["mer2/dtm", { opacity: 0.6, style: { ...PLAIN, quantity: "tilt", floor: 5 }, blend: null }],
    ] as const),
    ordered: true,
    sols: [156, 156] as const,
    more: new Map([["sun", "sol:156,14.5"]]),
  };
  const text = formatPermalink(link);
  expect(text).toBe(
    "#m=MER2&at=12.5,-3.25,0.02,45&on=mer2/stops*1*multiply,mer2-site0010-drive0064/slope*0.35,mer2/dtm*0.6~tilt::::5" +
      "&order=1&sol=156&sun=sol:156,14.5",
  );
  expect(parsePermalink(text)).toEqual(link);
});

test("an empty link leaves all to the viewer", () => {
  expect(parsePermalink("")).toEqual({
    mission: null,
    place: null,
    on: null,
    ordered: false,
    sols: null,
    more: new Map(),
  });
});

test("all layers off is not the same as no layers given", () => {
  expect(parsePermalink("#on=").on?.size).toBe(0);
});

test.each(["#at=1,2", "#at=1,2,0", "#at=1,2,-3", "#at=a,b,c"])("%s is not a place", (text) => {
  expect(parsePermalink(text).place).toBeNull();
});

test("opacity stays between 0 and 1", () => {
  const opacities = [...(parsePermalink("#on=a*7,b*-1,c*x").on ?? [])].map(
    ([id, { opacity }]) => [id, opacity] as const,
  );
  expect(opacities).toEqual([
    ["a", 1],
    ["b", 0],
    ["c", 1],
  ]);
});

test("what of a link cannot be read is named", () => {
  expect(unreadable("#m=MER2&at=1,2&sol=soon&on=mer2/dtm")).toEqual(["at=1,2", "sol=soon"]);
  expect(unreadable("#at=1,2,3&sol=156")).toEqual([]);
});
