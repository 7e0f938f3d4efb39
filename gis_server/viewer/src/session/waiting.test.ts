import { beforeEach, describe, expect, it, vi } from "vitest";
import type { Shell } from "../page/shell";
import { Waiting } from "./waiting";

const dataset: Record<string, string> = {};
const page = { banner: () => undefined } as unknown as Shell;

/** Lets pending callbacks run. */
const passed = () => new Promise((resolve) => setTimeout(resolve));

beforeEach(() => {
  delete dataset["ready"];
  vi.stubGlobal("document", { documentElement: { dataset } });
});

describe("waiting", () => {
  it("calls the page ready when the map is drawn again with the rest of the page", async () => {
    const waiting = new Waiting(page, () => waiting.settle());
    waiting.settle();
    await waiting.painted;
    expect(dataset["ready"]).toBeUndefined();
    waiting.run(async () => waiting.whole());
    expect(dataset["ready"]).toBe("false");
    await passed();
    expect(dataset["ready"]).toBe("true");
  });

  it("calls it ready too where the rest of the page came before the map was drawn", async () => {
    const waiting = new Waiting(page, () => undefined); // the map has still to load
    waiting.run(async () => waiting.whole());
    await passed();
    expect(dataset["ready"]).toBe("false");
    waiting.settle(); // nothing requests another frame after this one
    expect(dataset["ready"]).toBe("true");
  });

  it("is not ready while something is awaited", () => {
    const waiting = new Waiting(page, () => undefined);
    waiting.whole();
    waiting.run(() => passed() as Promise<void>);
    waiting.settle();
    expect(dataset["ready"]).toBe("false");
  });
});
