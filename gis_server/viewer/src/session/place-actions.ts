/** Actions at a place of the map; the context menu lists them. */

import type { MapPoint } from "../server/records";

export interface PlaceAction {
  readonly title: string;
  readonly run: (point: MapPoint) => void;
  /** Whether it is available now; else it is not listed. */
  readonly isOffered?: () => boolean;
}

export class PlaceActions {
  private readonly list: PlaceAction[] = [];

  add(action: PlaceAction): void {
    this.list.push(action);
  }

  get offered(): readonly PlaceAction[] {
    return this.list.filter(({ isOffered }) => isOffered?.() ?? true);
  }
}
