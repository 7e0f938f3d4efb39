/**
 * Annotations that the server has not stored yet, kept in the browser meanwhile: no typed text is lost
 * when the server is away, the page is closed or the token has ended.
 */

import type { AnnotationEdit } from "../../server/edits";

export interface Unsent {
  /** Names it in this browser. */
  readonly key: string;
  readonly annotation: AnnotationEdit;
}

type Kept = Pick<Storage, "getItem" | "setItem">;

export class Outbox {
  private readonly name: string;

  constructor(
    mission: string,
    private readonly storage: Kept = localStorage,
  ) {
    this.name = `solmap-unsent-${mission}`;
  }

  get all(): readonly Unsent[] {
    try {
      const kept: unknown = JSON.parse(this.storage.getItem(this.name) ?? "[]");
      return Array.isArray(kept) ? (kept as Unsent[]) : [];
    } catch {
      return []; // something else wrote there
    }
  }

  add(annotation: AnnotationEdit): Unsent {
    const unsent = { key: `${Date.now()}-${Math.random()}`, annotation };
    this.keep([...this.all, unsent]);
    return unsent;
  }

  remove({ key }: Unsent): void {
    this.keep(this.all.filter((one) => one.key !== key));
  }

  private keep(all: readonly Unsent[]): void {
    this.storage.setItem(this.name, JSON.stringify(all));
  }
}
