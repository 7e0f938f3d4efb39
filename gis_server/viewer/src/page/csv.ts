/** Rows of CSV files. */

export type Cell = string | number | null | undefined;

const quoteIfNeeded = (text: string) =>
  /[",\n]/.test(text) ? `"${text.replaceAll('"', '""')}"` : text;

export const csvRow = (cells: readonly Cell[]): string =>
  cells.map((cell) => quoteIfNeeded(String(cell ?? ""))).join(",");
