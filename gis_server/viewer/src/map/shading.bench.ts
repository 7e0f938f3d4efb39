import { bench } from "vitest";
import { pen } from "./painting";
import { RAMPS } from "./ramps";
import { quantityOf } from "./shading";
import { shadows } from "./shadows";
import { gradientsOf, STRIDE, ValueTile } from "./value-tiles";

const SUN = { azimuthDeg: 300, elevationDeg: 20 };
const SIDE = 1536;
const rough = (count: number) =>
  Float32Array.from({ length: count }, (_, k) => Math.sin(k / 37) + 0.3 * Math.sin(k * 12.9898));
const tile = new ValueTile(rough(STRIDE * STRIDE), 0.08);
const ground = { heights: rough(SIDE * SIDE), columns: SIDE, rows: SIDE, cell_m: 0.08 };
const draw = pen({ colours: RAMPS.grey, low: 0, high: 1, floor: null, unit: "" });
const light = quantityOf(tile, "relief", SUN);

bench("gradients of a tile", () => void gradientsOf(tile.values, 0.08));
bench("relief of a tile", () => void quantityOf(tile, "relief", SUN));
bench("slope of a tile", () => void quantityOf(tile, "slope", SUN));
bench("northerly tilt of a tile", () => void quantityOf(tile, "tilt", SUN));
bench("colours of a tile", () => void draw(light));
bench("shadows of 2.4 million cells", () => void shadows(ground, SUN));
