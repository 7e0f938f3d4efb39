import { expect, test } from "vitest";
import { pdfOf } from "./pdf";

test("each object starts at the offset that the cross-reference table states, and the page is as large as on paper", () => {
  const text = new TextDecoder("latin1").decode(pdfOf(new Uint8Array([255, 216]), [200, 100], 100));
  expect(text).toContain("/MediaBox [0 0 144.000 72.000]");
  const starts = [...text.matchAll(/^(\d{10}) 00000 n /gm)].map(([, at]) => Number(at));
  expect(starts).toHaveLength(5);
  for (const [at, start] of starts.entries())
    expect(text.slice(start).startsWith(`${at + 1} 0 obj\n`)).toBe(true);
  const table = Number(/startxref\n(\d+)/.exec(text)?.[1]);
  expect(text.slice(table).startsWith("xref\n")).toBe(true);
});
