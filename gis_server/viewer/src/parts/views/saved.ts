/** Views that were saved in this browser: names for links, and the file in which they go from browser to browser. */

const KEY = "solmap-views";
const FORMAT = "solmap-views";

export interface SavedView {
  readonly name: string;
  /** The fragment of the address, as `session/state.ts` writes it. */
  readonly link: string;
}

const isView = (one: unknown): one is SavedView => {
  const { name, link } = (one ?? {}) as Partial<SavedView>;
  return typeof name === "string" && name !== "" && typeof link === "string" && link[0] === "#";
};

/** An unused name: with a number appended if a view has it already. */
export function freeName(title: string, views: readonly SavedView[]): string {
  const isTaken = (name: string) => views.some((view) => view.name === name);
  let name = title;
  for (let n = 2; isTaken(name); n += 1) name = `${title} (${n})`;
  return name;
}

/** The views together with those of a file, without duplicates. */
export function merged(
  views: readonly SavedView[],
  more: readonly SavedView[],
): readonly SavedView[] {
  const all = [...views];
  for (const { name, link } of more) {
    if (all.some((view) => view.link === link && view.name === name)) continue;
    all.push({ name: freeName(name, all), link });
  }
  return all;
}

export const formatViews = (views: readonly SavedView[]): string =>
  `${JSON.stringify({ format: FORMAT, version: 1, views }, null, 2)}\n`;

/** The views of a file; an error names what is wrong with it. */
export function parseViews(text: string): readonly SavedView[] {
  let read: { format?: unknown; version?: unknown; views?: unknown } | null;
  try {
    read = JSON.parse(text) as typeof read;
  } catch {
    throw new Error("The file is not JSON.");
  }
  if (read?.format !== FORMAT) throw new Error("The file holds no saved views of solmap.");
  if (read.version !== 1) throw new Error(`Version ${String(read.version)} is unknown here.`);
  if (!Array.isArray(read.views) || !read.views.every(isView))
    throw new Error("A view of the file has no name or no link.");
  return read.views.map(({ name, link }) => ({ name, link }));
}

/** Read again each time: other windows of this browser save views too. */
export class SavedViews {
  constructor(private readonly storage: Pick<Storage, "getItem" | "setItem"> = localStorage) {}

  get all(): readonly SavedView[] {
    try {
      return parseViews(this.storage.getItem(KEY) ?? formatViews([]));
    } catch {
      return []; // another program wrote there
    }
  }

  /** Saves what `change` makes of the views. */
  keep(change: (views: readonly SavedView[]) => readonly SavedView[]): void {
    this.storage.setItem(KEY, formatViews(change(this.all)));
  }
}
