/** Lines of tables for spreadsheets. */

export type Cell = string | number | null | undefined;

const quoted = (text: string) => (/[",\n]/.test(text) ? `"${text.replaceAll('"', '""')}"` : text);

export const csvRow = (cells: readonly Cell[]): string =>
  cells.map((cell) => quoted(String(cell ?? ""))).join(",");
