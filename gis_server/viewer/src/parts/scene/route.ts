/** Traverse and stops in space: telemetry blue, adjusted red, as on the map; error ellipsoids; names. */

import { Group } from "three";
import { ADJUSTED, TELEMETRY } from "../../map/styles";
import type { Place3, SceneStop } from "../../server/scene";
import { discard, dots, ellipsoid, nameplate, path } from "./drawings";

export class Route {
  readonly traverse = new Group();
  readonly ellipsoids = new Group();

  constructor(
    private readonly stops: readonly SceneStop[],
    private readonly origin: Place3,
  ) {
    const adjusted = stops.map(({ place }) => place);
    const telemetry = stops.map((stop) => stop.telemetry);
    if (stops.length === 0) return;
    this.traverse.add(
      path(telemetry, origin, { color: TELEMETRY, width: 2.5, dashed: true, above: true }),
      path(adjusted, origin, { color: ADJUSTED, width: 3, above: true }),
      dots(telemetry, origin, TELEMETRY, 7),
      dots(adjusted, origin, ADJUSTED, 9),
      ...stops.map((stop) => nameplate(`${stop.site}/${stop.drive}`, stop.place, origin)),
    );
  }

  /** Draws the ellipsoids so many times as large as they are. */
  enlarge(factor: number): void {
    for (const old of [...this.ellipsoids.children]) discard(old);
    this.ellipsoids.add(...this.stops.map((stop) => ellipsoid(stop, this.origin, factor)));
  }
}
