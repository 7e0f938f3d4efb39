import { expect, test, vi } from "vitest";

vi.stubGlobal("matchMedia", () => ({ matches: true, addEventListener: () => undefined }));
const { roomFor } = await import("./panes");

test("as many panes as have 320 pixels beside the map's 320, at most three side by side", () => {
  expect(roomFor(792, true, true)).toEqual({ across: 1, most: 2 });
  expect(roomFor(1272, true, true)).toEqual({ across: 2, most: 2 });
  expect(roomFor(1912, true, true)).toEqual({ across: 3, most: 3 });
});

test("one pane below the width of a laptop", () => {
  expect(roomFor(632, true, false)).toEqual({ across: 1, most: 1 });
  expect(roomFor(1099, false, false)).toEqual({ across: 1, most: 1 });
});
