/** The frames of sites and stops, requested once from the server until it publishes again. */

import { ApiError } from "../server/api";
import { sceneApi, type SceneStops } from "../server/scene";

const NONE: SceneStops = { network: null, body: null, stops: [], sites: [] };

export class StopFrames {
  private loading: Promise<SceneStops> | null = null;

  constructor(
    private readonly mission: string,
    private readonly signal: AbortSignal,
  ) {}

  /** Frames of the stops; empty if the server has none. */
  load(): Promise<SceneStops> {
    this.loading ??= sceneApi.stops(this.mission, this.signal).catch((reason: unknown) => {
      this.forget();
      if (reason instanceof ApiError) return NONE;
      throw reason;
    });
    return this.loading;
  }

  forget(): void {
    this.loading = null;
  }
}
