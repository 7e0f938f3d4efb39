import { expect, test } from "vitest";

const SOURCES = import.meta.glob<string>("../**/*.ts", {
  query: "?raw",
  import: "default",
  eager: true,
});

/** The part that a module belongs to; null: none. */
const partOf = (path: string) => /(?:^|\/)parts\/([^/]+)\//.exec(path)?.[1] ?? null;

test("parts import nothing of each other", () => {
  const foreign = Object.entries(SOURCES).flatMap(([path, text]) => {
    const part = partOf(path);
    const imported = [...text.matchAll(/(?:from|import) ?\(?"(\.[^"]+)"/g)].map(
      ([, target = ""]) => new URL(target, new URL(path, "file:///src/session/")).pathname,
    );
    return imported
      .filter((target) => part !== null && partOf(target) !== null && partOf(target) !== part)
      .map((target) => `${path} imports ${target}`);
  });
  expect(foreign).toEqual([]);
});
