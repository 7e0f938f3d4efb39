import { expect, test } from "vitest";
import type { Seen } from "../../server/projection";
import { markAt, seenText } from "./strip";

const seen: Seen = {
  image: "2NA",
  stop: "mer2-site0010-drive0000",
  sol: 155,
  instrument: "NAVCAM",
  eye: "left",
  sample: 255.5,
  line: -0.5,
  ellipse: { semi_major_px: 1, semi_minor_px: 1, angle_deg: 0 },
  range_m: 12.34,
  incidence_deg: 85,
  sight: "hidden",
  told_by: "terrain",
  linearised_sample: null,
  linearised_line: null,
  browse: "",
};

test("a mark lies where the pixel is, counted from the image's edge", () => {
  expect(markAt(seen, [1024, 1024])).toEqual([25, 0]);
});

test("an image states whether it sees the place, from which distance and at which angle", () => {
  expect(seenText(seen)).toBe("2NA: hidden by ground, 12.3 m away, grazing");
  expect(seenText({ ...seen, sight: "visible", incidence_deg: null })).toBe(
    "2NA: seen, 12.3 m away",
  );
});
