/** The frames of sites and stops, asked of the server once until it publishes anew. */

import { ApiError } from "../server/api";
import { sceneApi, type SceneStops } from "../server/scene";

const NONE: SceneStops = { network: null, body: null, stops: [], sites: [] };

export class StopFrames {
  private asked: Promise<SceneStops> | null = null;

  constructor(
    private readonly mission: string,
    private readonly alive: AbortSignal,
  ) {}

  /** None where the server has none to tell. */
  load(): Promise<SceneStops> {
    this.asked ??= sceneApi.stops(this.mission, this.alive).catch((reason: unknown) => {
      this.forget();
      if (reason instanceof ApiError) return NONE;
      throw reason;
    });
    return this.asked;
  }

  forget(): void {
    this.asked = null;
  }
}
