/** Keys that do something, and the list of them. */

export interface Shortcut {
  readonly key: string;
  readonly does: string;
  readonly run: () => void;
}

const TYPING = ["INPUT", "SELECT", "TEXTAREA"];

export class Shortcuts {
  private readonly list: Shortcut[] = [];

  /** Escape may have several commands; any other key has one. */
  add(key: string, does: string, run: () => void): void {
    const taken = key !== "Escape" && this.list.some((shortcut) => shortcut.key === key);
    if (taken) throw new Error(`the key ${key} does something already`);
    this.list.push({ key, does, run });
  }

  get all(): readonly Shortcut[] {
    return this.list;
  }

  readonly pressed = (event: KeyboardEvent): void => {
    if (event.altKey) return;
    const pressed = event.ctrlKey || event.metaKey ? `Ctrl+${event.key}` : event.key;
    const isTyping = TYPING.includes((event.target as HTMLElement).tagName);
    if (isTyping && event.key !== "Escape") return;
    const meant = this.list.filter(({ key }) => key === pressed);
    // The letter is not typed into a box that the shortcut enters.
    if (meant.length > 0 && event.key !== "Escape") event.preventDefault();
    for (const { run } of meant) run();
  };
}
