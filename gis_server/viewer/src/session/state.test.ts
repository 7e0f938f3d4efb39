import { expect, test } from "vitest";
import { BLEND_NAMES } from "../map/blending";
import { RAMP_NAMES } from "../map/ramps";
import { PLAIN } from "../map/raster-style";
import type { Side } from "../page/panes";
import { TABS } from "../page/tabs";
import type { MapPoint } from "../server/records";
import {
  ALL_ROWS,
  COMPARISONS,
  DARK,
  formatLink,
  type ImageSight,
  type Key,
  MEASURES,
  PANES,
  parseLink,
  type State,
  TABLES,
  WAYS,
} from "./state";

/** Numbers between 0 and 1 that follow from a seed (mulberry32). */
function random(seed: number): () => number {
  let at = seed;
  return () => {
    at = (at + 0x6d2b79f5) | 0;
    let t = Math.imul(at ^ (at >>> 15), 1 | at);
    t = (t + Math.imul(t ^ (t >>> 7), 61 | t)) ^ t;
    return ((t ^ (t >>> 14)) >>> 0) / 2 ** 32;
  };
}

const WORDS = ["mer2/dtm", "a~b", "50 %", "x,y;z", "ä&b=c", "mer2-site0010-drive0064", "#1+1"];

/** A state in which every field has some value that a link holds without rounding. */
function anyState(seed: number): State {
  const next = random(seed);
  const some = <T>(all: readonly T[]): T => all[Math.floor(next() * all.length)] as T;
  const number = (decimals: number, least: number, most: number) =>
    Number((least + next() * (most - least)).toFixed(decimals)) + 0; // no -0
  const maybe = <T>(make: () => T): T | null => (next() < 0.2 ? null : make());
  const several = <T>(make: () => T): T[] => Array.from({ length: next() * 4 }, make);
  const point = (): MapPoint => [number(3, -500, 500), number(3, -500, 500)];
  const sight = (): ImageSight => ({
    sample: number(1, 0, 1024),
    line: number(1, 0, 1024),
    scale: number(4, 0.1, 8),
  });
  const style = () => ({
    ...PLAIN,
    quantity: some(["slope", "tilt", "class"] as const),
    ramp: maybe(() => some(RAMP_NAMES)),
    low: maybe(() => number(1, -90, 0)),
    high: maybe(() => number(1, 1, 90)),
    hidden: several(() => number(0, 0, 9)),
    fade: maybe(() => number(2, 0.1, 3)),
  });
  const layer = () => ({
    opacity: number(2, 0, 1),
    style: maybe(style),
    blend: maybe(() => some(BLEND_NAMES)),
  });
  const mode = some(COMPARISONS);
  const comparison = {
    mode,
    a: some(WORDS),
    b: some(WORDS),
    at: mode === "swipe" ? number(3, 0, 1) : 0.5,
    most: mode === "swipe" ? null : maybe(() => number(3, 0.001, 9)),
  };
  const sky = some([
    { by: "time", sol: number(0, 0, 999), hours: number(3, 0, 24) },
    { by: "hand", sun: { azimuthDeg: number(1, 0, 359), elevationDeg: number(1, -90, 90) } },
  ] as const);
  const places: Record<Side, string[]> = { beside: [], below: [] };
  for (const name of PANES) if (next() < 0.6) places[some(["beside", "below"] as const)].push(name);
  const three = () => [number(2, -99, 99), number(2, -99, 99), number(2, -9, 9)] as const;
  const sol = number(0, 1, 900);
  return {
    m: maybe(() => some(WORDS)),
    at: maybe(() => ({
      east: number(3, -900, 900),
      north: number(3, -900, 900),
      resolution: number(6, 0.001, 50),
      rotationDeg: number(1, -180, 180),
    })),
    on: maybe(() => new Map(several(() => [some(WORDS), layer()] as const))),
    order: next() < 0.5,
    grid: next() < 0.5,
    sol: maybe(() => [sol, sol + number(0, 0, 9)] as const),
    filter: { words: some(["", "slope 50 %", "~"]), kind: some(["", "Slope"]), instrument: "" },
    tab: some(TABS),
    pt: maybe(point),
    stop: maybe(() => some(WORDS)),
    images: maybe(() => some(WORDS)),
    measure: several(() => ({
      mode: some(MEASURES),
      corners: [point(), ...several(point)],
      numbers: several(() => number(3, 0, 99)),
      layer: maybe(() => some(WORDS)),
    })),
    solutions: { solution: some(["latest", ...WORDS]), reference: "telemetry" },
    compare: maybe(() => comparison),
    sun: maybe(() => sky),
    live: some([
      DARK,
      { ...DARK, relief: true, strength: number(2, 0.1, 1), shadow: next() < 0.5 },
      { ...DARK, tiltDeg: number(1, -89, 89), slopeDeg: number(1, 0, 89) },
    ]),
    ground: maybe(() => some(WORDS)),
    show3d: { drape: some(["", "slope"]), stop: maybe(() => "mer2-site0010"), isStanding: true },
    panes: places,
    image: maybe(() => ({ id: some(WORDS), sight: maybe(sight) })),
    stereo: maybe(() => ({
      left: some(["", ...WORDS]),
      way: some(WAYS),
      parallax: maybe(() => number(0, -99, 99)),
      sight: maybe(sight),
    })),
    panorama: maybe(() => ({
      stop: some(["", ...WORDS]),
      sight: maybe(() => ({
        azimuth: number(2, 0, 360),
        elevation: number(2, -30, 30),
        width: number(2, 1, 360),
      })),
    })),
    view3d: maybe(() => ({ look: maybe(() => ({ from: three(), to: three() })) })),
    network: maybe(() => some(["", ...WORDS])),
    profile: maybe(() => ({ of: number(0, 1, 9), shown: some(["elevation", "slope"] as const) })),
    traverse: maybe(() => true as const),
    table: maybe(() => ({
      subject: some(TABLES),
      hasAllColumns: next() < 0.5,
      sort: "sol",
      isDescending: next() < 0.5,
      words: some(["", "a & b", "50 %"]),
      choices: new Map(several(() => [some(["eye", "sol"]), some(WORDS)] as const)),
    })),
  };
}

test("a link holds every state", () => {
  for (let seed = 0; seed < 500; seed += 1) {
    const state = anyState(seed);
    const link = formatLink(state);
    expect(parseLink(link), link).toEqual({ state, unknown: [] });
    expect(formatLink(parseLink(link).state)).toBe(link);
  }
});

test("the characters of a link are those of a URL", () => {
  for (let seed = 0; seed < 100; seed += 1) {
    const link = formatLink(anyState(seed));
    expect(new URL(link, "http://a.b/").hash).toBe(link);
  }
});

test("the link to what is shown at first has no keys", () => {
  const { state, unknown } = parseLink("");
  expect(formatLink(state)).toBe("#");
  expect(unknown).toEqual([]);
});

const OLD =
  "#m=MER2&at=12.5,-3.25,0.02,45&on=mer2/stops*1*multiply,mer2-site0010-drive0064/slope*0.35,mer2/dtm*0.6~tilt::::5" +
  "&order=1&sol=150-156&sun=sol:156,14.5&tab=sun&pt=12.5,-3&image=2N126470398EDN0000P1001L0M1&stereo=2N12L" +
  "&panorama=mer2-site0010-drive0064&view3d=1,2,3,4,5,6.25&show3d=slope/mer2-site0010-drive0064/stand" +
  "&measure=distance:0,0;3,4/area:0,0;3,0;3,4&compare=swipe,mer2/dtm,mer2/slope,0.25" +
  "&live=relief*0.6,shadow,tilt:5&ground=mer2/dtm&table=of%3Dimages%26sort%3D-sol%26find%3Dnavcam%26is.eye%3Dleft";

test("links of earlier versions are read", () => {
  const { state, unknown } = parseLink(OLD);
  expect(unknown).toEqual([]);
  const expected: Partial<State> = {
    m: "MER2",
    at: { east: 12.5, north: -3.25, resolution: 0.02, rotationDeg: 45 },
    on: new Map([
      ["mer2/stops", { opacity: 1, style: null, blend: "multiply" }],
      ["mer2-site0010-drive0064/slope", { opacity: 0.35, style: null, blend: null }],
      ["mer2/dtm", { opacity: 0.6, style: { ...PLAIN, quantity: "tilt", floor: 5 }, blend: null }],
    ] as const),
    order: true,
    sol: [150, 156],
    sun: { by: "time", sol: 156, hours: 14.5 },
    tab: "sun",
    pt: [12.5, -3],
    image: { id: "2N126470398EDN0000P1001L0M1", sight: null },
    stereo: { left: "2N12L", way: "anaglyph", parallax: null, sight: null },
    panorama: { stop: "mer2-site0010-drive0064", sight: null },
    view3d: { look: { from: [1, 2, 3], to: [4, 5, 6.25] } },
    show3d: { drape: "slope", stop: "mer2-site0010-drive0064", isStanding: true },
    measure: [
      {
        mode: "distance",
        corners: [
          [0, 0],
          [3, 4],
        ],
        numbers: [],
        layer: null,
      },
      {
        mode: "area",
        corners: [
          [0, 0],
          [3, 0],
          [3, 4],
        ],
        numbers: [],
        layer: null,
      },
    ],
    compare: { mode: "swipe", a: "mer2/dtm", b: "mer2/slope", at: 0.25, most: null },
    live: { ...DARK, relief: true, strength: 0.6, shadow: true, tiltDeg: 5 },
    ground: "mer2/dtm",
    table: {
      ...ALL_ROWS,
      subject: "images",
      sort: "sol",
      isDescending: true,
      words: "navcam",
      choices: new Map([["eye", "left"]]),
    },
  };
  expect(state).toMatchObject(expected);
});

test("all layers off is not the same as no layers given", () => {
  expect(parseLink("#on=").state.on?.size).toBe(0);
  expect(parseLink("").state.on).toBeNull();
});

test.each<[link: string, key: Key, value: unknown]>([
  ["sol=156-150", "sol", [150, 156]],
  ["sun=-66.9,20.5", "sun", { by: "hand", sun: { azimuthDeg: 293.1, elevationDeg: 20.5 } }],
  [
    "compare=difference,a,b",
    "compare",
    { mode: "difference", a: "a", b: "b", at: 0.5, most: null },
  ],
  ["compare=swipe,a,b,7", "compare", { mode: "swipe", a: "a", b: "b", at: 0.5, most: null }],
  ["stereo=", "stereo", { left: "", way: "anaglyph", parallax: null, sight: null }],
])("%s is understood", (link, key, value) => {
  const { state, unknown } = parseLink(`#${link}`);
  expect(state[key]).toEqual(value);
  expect(unknown).toEqual([]);
});

test.each([
  ["zoom=3", ["zoom"]],
  ["at=1,2", ["at=1,2"]],
  ["at=1,2,0", ["at=1,2,0"]],
  ["at=a,b,c", ["at=a,b,c"]],
  ["sol=soon&tab=weather", ["sol=soon", "tab=weather"]],
  ["pt=1,2,3", ["pt=1,2,3"]],
  ["on=a*0.5,b*7,c~rainbow", ["on=b*7", "on=c~rainbow"]],
  ["measure=distance:0,0;1,x/area:0,0;1,0;1,1", ["measure=distance:0,0;1,x"]],
  ["sun=sol:1,25", ["sun=sol:1,25"]],
  ["sun=1,100", ["sun=1,100"]],
  ["live=rain,tilt:x,shadow", ["live=rain", "live=tilt:x"]],
  ["compare=blink,a,b", ["compare=blink,a,b"]],
  ["panes=image,globe", ["panes=globe"]],
  ["table=of%3Dclouds", ["table=of=clouds"]],
])("of %s the broken parts are named, and the rest is read", (link, broken) => {
  const { state, unknown } = parseLink(`#m=MER2&${link}`);
  expect([...unknown].sort()).toEqual([...broken].sort());
  expect(state.m).toBe("MER2");
});

test("what is broken in a list does not take the rest of it away", () => {
  const { state } = parseLink("#on=a*0.5,b*7&measure=distance:0/area:0,0;1,0;1,1&live=rain,shadow");
  expect([...(state.on?.keys() ?? [])]).toEqual(["a"]);
  expect(state.measure.map(({ mode }) => mode)).toEqual(["area"]);
  expect(state.live).toEqual({ ...DARK, shadow: true });
});
