/** Panoramas of the stops: which one, what is under the pointer, and the cursor shared with the map. */

import Feature from "ol/Feature";
import LineString from "ol/geom/LineString";
import VectorLayer from "ol/layer/Vector";
import VectorSource from "ol/source/Vector";
import Stroke from "ol/style/Stroke";
import Style from "ol/style/Style";
import { h } from "../../page/dom";
import { fixed, scopeTitle } from "../../page/format";
import { type Panorama, panoramaApi } from "../../server/panorama";
import type { MapPoint } from "../../server/records";
import { type Context, openImage } from "../../session/context";
import { Latest } from "../../session/latest";
import type { PanoramaSight } from "../../session/state";
import { type Direction, rayEnd } from "./angles";
import "./panorama.css";
import { Strip } from "./strip";

const REST_MS = 60;
const RAY_M = 100;
const RAY_HEIGHT = 1004;

const ray = [
  new Style({ stroke: new Stroke({ color: "rgba(0, 0, 0, 0.7)", width: 4 }) }),
  new Style({ stroke: new Stroke({ color: "#ffd400", width: 2, lineDash: [8, 5] }) }),
];

export class PanoramaView {
  readonly element: HTMLElement;
  private readonly host = h("div", { class: "panorama-host" });
  private readonly output = h("output", { class: "panorama-readout" });
  private readonly facts = h("small", {});
  private readonly rays = new VectorSource<Feature<LineString>>();
  private readonly layer = new VectorLayer({ source: this.rays, style: ray, zIndex: RAY_HEIGHT });
  private readonly queries: Latest;
  private readonly stopListening: readonly (() => void)[];
  private readonly choice: HTMLSelectElement;
  private strip: Strip | null = null;
  private isOwn = false;

  constructor(
    private readonly context: Context,
    private readonly panoramas: readonly Panorama[],
    private readonly write: (value: { stop: string; sight: PanoramaSight | null }) => void,
  ) {
    const { view, events, waiting } = context;
    this.queries = new Latest(REST_MS, (reason) => waiting.notify(String(reason)));
    this.choice = h(
      "select",
      {
        name: "panorama",
        "aria-label": "stop",
        onchange: () => this.open(this.choice.value, null),
      },
      ...panoramas.map(({ id, scope }) => h("option", { value: id }, scopeTitle(scope))),
    );
    const whole = h(
      "button",
      { type: "button", class: "plain", name: "whole", onclick: () => this.strip?.whole() },
      "whole",
    );
    this.element = h(
      "div",
      { class: "panorama", "data-settled": "false" },
      h("div", { class: "panorama-bar" }, this.choice, whole, this.facts),
      h("div", { class: "panorama-room" }, this.host, this.output),
    );
    view.map.addLayer(this.layer);
    this.stopListening = [
      events.pointer.on((pointed) => this.follow(pointed?.point ?? null)),
      events.cursor.on((point) => this.follow(point)),
    ];
  }

  /** The panorama of a stop; without its name, of the one nearest to the middle of the map. */
  show({ stop, sight }: { stop: string; sight: PanoramaSight | null }): void {
    const named = this.panoramas.find((one) => one.scope === stop);
    const chosen = named ?? nearest(this.panoramas, this.context.view.place);
    if (!chosen) return;
    if (chosen !== this.strip?.panorama) this.open(chosen.id, sight);
    else if (sight) this.strip.look(sight);
    else this.strip.whole();
  }

  dispose(): void {
    this.queries.stop();
    for (const stop of this.stopListening) stop();
    this.context.view.map.removeLayer(this.layer);
    this.strip?.dispose();
    this.context.events.cursor.emit(null);
  }

  private open(id: string, sight: PanoramaSight | null): void {
    const panorama = this.panoramas.find((one) => one.id === id);
    if (!panorama) return;
    this.choice.value = id;
    this.strip?.dispose();
    this.rays.clear();
    this.element.dataset["settled"] = "false";
    this.element.dataset["panorama"] = panorama.id;
    this.write({ stop: panorama.scope, sight });
    const strip = new Strip(panorama, {
      hover: (direction) => this.over(direction),
      click: (direction) => this.openImage(direction),
      moved: (now) => {
        if (this.strip === strip) this.write({ stop: panorama.scope, sight: now });
      },
      drawn: () => {
        this.element.dataset["settled"] = "true";
      },
    });
    this.strip = strip;
    this.host.replaceChildren(strip.element);
    if (sight) strip.look(sight);
    else requestAnimationFrame(() => strip.whole());
    const seams =
      panorama.registration_px === null
        ? ""
        : `, images meet to ${fixed(panorama.registration_px, 2)} px`;
    this.facts.replaceChildren(
      `${panorama.images.length} images, ${panorama.eye} eye${seams} `,
      h("a", { class: "text", href: panorama.download }, "file"),
    );
  }

  /** Describes a direction, and shows it on the map: the ray, and its intersection with the ground. */
  private over(direction: Direction | null): void {
    const { mission } = this.context;
    this.rays.clear();
    if (!direction || !this.strip) {
      this.queries.stop();
      this.output.textContent = "";
      this.emit(null);
      return;
    }
    const { panorama } = this.strip;
    const [azimuth, elevation] = direction;
    const readout = `azimuth ${fixed(azimuth, 2)}\u00b0  elevation ${fixed(elevation, 2)}\u00b0`;
    const [east, north] = panorama.centre;
    this.output.textContent = readout;
    this.drawRay([east, north], rayEnd([east, north], azimuth, RAY_M));
    this.queries.run(async (signal) => {
      const seen = await panoramaApi.direction(mission.mission, panorama, direction, signal);
      const { ground, shown } = seen;
      const where = ground
        ? `  \u00b7  east ${fixed(ground.east, 2)}  north ${fixed(ground.north, 2)}  elevation ${fixed(ground.up, 2)} m, ${fixed(ground.distance_m, 2)} m away`
        : "";
      this.output.textContent = `${readout}${where}${shown ? `  \u00b7  ${shown.image}` : ""}`;
      this.element.dataset["ground"] = ground ? `${ground.east},${ground.north}` : "";
      if (ground) this.drawRay([east, north], [ground.east, ground.north]);
      this.emit(ground ? [ground.east, ground.north] : null);
    });
  }

  /** The cursor of this view, which it does not follow itself. */
  private emit(point: MapPoint | null): void {
    this.isOwn = true;
    this.context.events.cursor.emit(point);
    this.isOwn = false;
  }

  private drawRay(from: MapPoint, to: MapPoint): void {
    this.rays.clear();
    this.rays.addFeature(new Feature(new LineString([[...from], [...to]])));
  }

  /** Marks a place that the map points at where it is seen. */
  private follow(point: MapPoint | null): void {
    const { strip, isOwn } = this;
    if (isOwn || !strip) return;
    if (!point) {
      strip.put(null);
      return;
    }
    const { mission } = this.context.mission;
    this.queries.run(async (signal) => {
      const seen = await panoramaApi.place(mission, strip.panorama, point, signal);
      strip.put(seen.inside ? [seen.azimuth_deg, seen.elevation_deg] : null, seen.hidden === true);
      const sight =
        seen.hidden === null ? "" : seen.hidden ? ", behind nearer ground" : ", in sight";
      this.element.dataset["marked"] = `${seen.azimuth_deg},${seen.elevation_deg}`;
      this.output.textContent = `azimuth ${fixed(seen.azimuth_deg, 2)}\u00b0  elevation ${fixed(seen.elevation_deg, 2)}\u00b0  ${fixed(seen.distance_m, 2)} m away${sight}`;
    });
  }

  private openImage(direction: Direction): void {
    const { waiting, mission } = this.context;
    const { strip } = this;
    if (!strip) return;
    waiting.run(async () => {
      const seen = await panoramaApi.direction(mission.mission, strip.panorama, direction);
      if (seen.shown) openImage(this.context, seen.shown.image);
    });
  }
}

function nearest(
  panoramas: readonly Panorama[],
  { east, north }: { readonly east: number; readonly north: number },
): Panorama | undefined {
  const apart = ({ centre }: Panorama) => Math.hypot(centre[0] - east, centre[1] - north);
  return panoramas.toSorted((a, b) => apart(a) - apart(b))[0];
}
