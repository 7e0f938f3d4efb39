import { describe, expect, it } from "vitest";
import { toneBetween } from "./join";

describe("toneBetween", () => {
  it("finds the gain and the offset of shades, whatever a few pixels show", () => {
    const own = Array.from({ length: 1000 }, (_, k) => 40 + (k % 120));
    const merged = own.map((shade, k) => (k % 50 === 0 ? 255 : 1.25 * shade - 20));
    const { gain, offset } = toneBetween(own, merged);
    expect(gain).toBeCloseTo(1.25, 1);
    expect(offset * 255).toBeCloseTo(-20, -1);
  });

  it("changes nothing where too little is known", () => {
    expect(toneBetween([10, 20], [30, 60])).toEqual({ gain: 1, offset: 0 });
  });
});
