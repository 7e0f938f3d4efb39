/** The 3D view: ground, traverse, rover, cameras and tie points, and the cursor that it shares with the map. */

import { Group, type Points } from "three";
import type { SunPlace } from "../../map/shading";
import { kindTitle } from "../../map/kinds";
import { h } from "../../page/dom";
import { fixed } from "../../page/format";
import type { MapPoint } from "../../server/records";
import { type Model, type Place3, type SceneStops, sceneApi } from "../../server/scene";
import { type Context, identify, openImage } from "../../session/context";
import type { Viewpoint, Shown } from "../../session/state";
import { rasterLegend } from "../../map/legend";
import { Cloud } from "./surface/cloud";
import { type ControlPanel, type Choices, controls } from "./controls";
import { dots } from "./drawings";
import { Flight } from "./camera/flight";
import { middle } from "./geometry";
import { type Side, addPointerControls } from "./camera/pointer";
import { Marker } from "./marker";
import { roverModel, stand } from "./rover";
import { Route } from "./route";
import "./scene.css";
import { Sights } from "./sights";
import { Stage } from "./stage";
import { drapable, drapeOf, layerFor, mergedPhotograph } from "./surface/drape";
import { Partition } from "./surface/partition";
import { Terrain } from "./surface/terrain";
import { Tape } from "./tape";
import { tiePlaces } from "./ties";

const TIE = "#7a4dd8";
/**
 * The camera rests after this time without movement; completeness is checked after this time without a frame.
 */
const REST_MS = 300;

/** The ground of every stop: tiles where there are, else one file. */
function groundOf(models: readonly Model[]): readonly Model[] {
  const tiled = new Set(models.filter(({ kind }) => kind === "tileset").map(({ scope }) => scope));
  return models.filter(
    ({ kind, scope }) => kind === "tileset" || (kind === "model" && !tiled.has(scope)),
  );
}

export class SceneView {
  readonly element: HTMLElement;
  private readonly host = h("div", { class: "scene-view" });
  private readonly readout = h("output", { class: "scene-place" }, "loading the ground");
  private readonly card = h("div", { class: "scene-card", hidden: true });
  private readonly measured = h("div", { class: "scene-card measured", hidden: true });
  private readonly legend = h("div", { class: "scene-legend", hidden: true });
  private readonly stage: Stage;
  private readonly terrain: Terrain;
  private readonly marker: Marker;
  private readonly sights: Sights;
  private readonly route: Route;
  private readonly rover = new Group();
  private readonly panel: ControlPanel;
  private readonly choices: Readonly<Choices>;
  private readonly tape: Tape;
  private readonly closing = new AbortController();
  private readonly flight: Flight;
  private awaiting: ReturnType<typeof setTimeout> | undefined;
  private views: Terrain | null = null;
  private requested: MapPoint | null = null;
  private cloud: Cloud | null = null;
  private ties: Points | null = null;

  constructor(
    private readonly context: Context,
    private readonly models: readonly Model[],
    private readonly stops: SceneStops,
    /** The first viewpoint (null: above all ground), and what is shown. */
    private readonly linked: { readonly viewpoint: Viewpoint | null; readonly shown: Shown },
    private readonly callbacks: {
      readonly viewpoint: (to: Viewpoint) => void;
      readonly shown: (shown: Shown) => void;
    },
  ) {
    const { origin, size, lowest } = middle(groundOf(models));
    this.stage = new Stage(this.host, origin, lowest);
    this.terrain = this.newTerrain();
    this.marker = new Marker(this.stage, this.terrain);
    this.sights = new Sights(this.stage, this.terrain);
    this.flight = new Flight(this.stage, this.marker, this.rover, size, (at) => {
      panel.setCameraMode(at);
      this.reportShown(at === "standing");
    });
    this.tape = new Tape(this.stage, this.measured, (corners, box) =>
      context.events.measure.emit({ corners, box }),
    );
    this.route = new Route(stops.stops, origin);
    this.route.enlarge(context.drawing.ellipseFactor);
    const { traverse, ellipsoids } = this.route;
    this.stage.world.add(traverse, ellipsoids, this.rover, this.sights.group);
    if (stops.body) this.rover.add(roverModel(stops.body));
    const names = stops.stops.map((s) => [s.stop, `stop ${s.site}/${s.drive}`] as const);
    const panel = controls(names, drapable(context), context.sun.value, {
      lit: (sun) => context.state.set("sun", { by: "hand", sun }),
      changed: (_, name) => this.changed(name),
      overview: () => this.flight.over(),
      stand: () => this.stand(),
      walk: () => this.walk(),
      measure: () => this.toggleTape(),
      fullScreen: () => void this.element.requestFullscreen(),
    });
    this.panel = panel;
    this.choices = panel.choices;
    this.addSunControl(panel);
    this.host.append(this.readout, this.card, this.measured, this.legend, panel.options);
    this.element = h("div", { class: "scene", "data-settled": "false" }, this.host, panel.element);
    this.stage.onFrame = () => {
      this.terrain.update(this.stage.camera, this.stage.renderer);
      this.views?.update(this.stage.camera, this.stage.renderer);
      this.cloud?.update(this.stage.camera, this.stage.renderer);
      this.fly();
      this.await();
    };
    this.terrain.add(groundOf(models));
    void this.terrain.part(Partition.all(context));
    this.listen();
    const { drape, stop } = linked.shown;
    panel.choose({ drape, stop });
    this.drape();
    this.chooseStop();
    this.begin();
  }

  look({ from, to }: Viewpoint): void {
    this.flight.leave();
    this.stage.look(from, to);
  }

  /** Shows the view of another link. */
  show({ drape, stop, isStanding }: Shown): void {
    this.panel.choose({ drape, stop });
    this.drape();
    this.chooseStop();
    if (isStanding) this.stand();
    else this.flight.leave();
  }

  private begin(): void {
    if (this.linked.viewpoint) this.look(this.linked.viewpoint);
    else this.flight.over();
  }

  private stand(): void {
    if (this.stop) this.flight.stand(this.stop, this.stops.body);
  }

  private walk(): void {
    if (this.choices.stop) {
      this.panel.choose({ ...this.choices, stop: null });
      this.chooseStop();
    }
    const at = (place: Place3) => this.showPlace(place);
    const { stops, body } = this.stops;
    if (this.flight.isWalking) this.flight.halt();
    else this.flight.walk(stops, body, { speed: () => this.choices.walkSpeed, at });
  }

  private toggleTape(): void {
    this.tape.toggle();
    this.panel.putMeasuring(this.tape.isOn);
  }

  /** Drapes the chosen kind of layer over the ground, with its legend; by default the merged orthophoto. */
  private drape(): void {
    const { context, choices, terrain, legend } = this;
    const { drape: chosen, stop, shading } = choices;
    const isPhotograph = !chosen && stop === null && shading !== "relief";
    const kind = isPhotograph ? mergedPhotograph(context) : chosen || null;
    terrain.drape(
      kind ?? "",
      kind
        ? async (scope, bounds) => {
            const layer = layerFor(context, kind, scope, choices.stop !== null, bounds);
            return layer && (await drapeOf(context, layer, bounds));
          }
        : null,
    );
    const layer = chosen ? layerFor(context, chosen, stop ?? "", stop !== null) : null;
    const drawn = layer && rasterLegend(layer, context.layers.state(layer).style);
    legend.hidden = !drawn;
    legend.replaceChildren(...(drawn ? [h("h2", {}, kindTitle(layer.kind)), drawn] : []));
    this.element.dataset["settled"] = "false";
    this.stage.requestFrame();
    this.settled();
  }

  /** Looks at a place of the map, as soon as its ground is drawn. */
  visit(point: MapPoint): void {
    this.requested = point;
    this.stage.requestFrame();
  }

  /** Loaded tiles are part of the ground from the next frame on. */
  private fly(): void {
    if (!this.requested || this.element.dataset["settled"] !== "true") return;
    const ground = this.marker.ground(this.requested);
    if (!ground) return;
    this.requested = null;
    this.flight.near(ground);
    this.element.dataset["visited"] = "true";
  }

  dispose(): void {
    this.closing.abort();
    clearTimeout(this.awaiting);
    this.context.events.cursor.emit(null);
    this.terrain.dispose();
    this.views?.dispose();
    this.cloud?.dispose();
    this.stage.dispose();
  }

  /** The sun that shades the map lights the ground as well. */
  private addSunControl({ putSun }: ControlPanel): void {
    const { sun } = this.context;
    const light = ({ azimuthDeg, elevationDeg }: SunPlace) =>
      this.stage.lightFrom(azimuthDeg, elevationDeg);
    const moved = (place: SunPlace) => {
      putSun(place);
      light(place);
    };
    light(sun.value);
    this.closing.signal.addEventListener("abort", sun.changed.on(moved));
  }

  private newTerrain(): Terrain {
    const terrain = new Terrain(
      this.stage.origin,
      this.stage.requestFrame,
      () => this.settled(),
      (reason) => this.context.waiting.notify(`a model cannot be shown: ${reason.message}`),
    );
    this.stage.world.add(terrain.group);
    return terrain;
  }

  /** Checks repeatedly whether all has been loaded: a download that ends without a tile to show requests no frame. */
  private await(): void {
    clearTimeout(this.awaiting);
    if (this.element.dataset["settled"] === "true") return;
    this.settled();
    this.awaiting = setTimeout(this.stage.requestFrame, REST_MS);
  }

  private settled(): void {
    if (!this.terrain.isSettled || (this.views && !this.views.isSettled)) return;
    if (!this.element.dataset["triangles"]) {
      this.readout.textContent = "";
      this.begin(); // now there is ground to look at
      if (this.linked.shown.isStanding) this.stand();
    }
    this.element.dataset["settled"] = "true";
    this.element.dataset["triangles"] = String(this.terrain.triangles);
    this.sights.draw();
    this.stage.requestFrame();
  }

  private changed(name: keyof Choices): void {
    const { stage, choices } = this;
    switch (name) {
      case "stop":
        this.chooseStop();
        this.drape();
        if (choices.stop && this.stop) this.flight.near(this.stop.place);
        else this.flight.over();
        this.reportShown();
        return;
      case "shading":
        this.terrain.shading = choices.shading;
        return this.drape();
      case "drape":
        this.drape();
        this.reportShown();
        return;
      case "walkSpeed":
        return;
      case "exaggeration":
        stage.exaggeration = choices.exaggeration;
        return;
      case "anaglyph":
        stage.isAnaglyph = choices.anaglyph;
        return;
      case "ties":
        return this.showTies();
      case "views":
        return this.showViews();
      case "points":
        return this.showPoints();
      case "pointSize":
        if (this.cloud) this.cloud.size = choices.pointSize;
        return;
      default:
        this.showParts();
    }
  }

  private showParts(): void {
    this.terrain.group.visible = this.choices.ground;
    this.rover.visible = this.choices.rover;
    this.sights.group.visible = this.choices.cameras;
    this.route.traverse.visible = this.choices.traverse;
    this.route.ellipsoids.visible = this.choices.ellipsoids;
    this.stage.requestFrame();
  }

  /** The stop whose rover and cameras are shown: the chosen one, else the last. */
  private get stop() {
    const { stops } = this.stops;
    return stops.find(({ stop }) => stop === this.choices.stop) ?? stops.at(-1);
  }

  private chooseStop(): void {
    const { stop, closing, context } = this;
    this.terrain.show(this.choices.stop);
    this.cloud?.show(this.choices.stop);
    if (!stop) return;
    const [east, north, up] = this.stage.origin;
    const at = this.stage.drawn(stop.place);
    at.set(stop.place[0] - east, stop.place[1] - north, stop.place[2] - up);
    for (const part of this.rover.children) stand(part, stop, at);
    this.showParts();
    context.waiting.run(async () => {
      const { mission } = context.mission;
      const cameras = await sceneApi.cameras(mission, stop.stop, closing.signal);
      if (this.stop === stop) this.sights.show(cameras);
    });
  }

  private showViews(): void {
    this.views ??= this.newTerrain();
    this.views.group.visible = this.choices.views;
    if (this.choices.views && this.views.group.children.length === 0) {
      this.element.dataset["settled"] = "false";
      this.views.add(this.models.filter(({ kind }) => kind === "view-model"));
    }
    this.stage.requestFrame();
  }

  private showPoints(): void {
    const { stage, choices, context, element } = this;
    const models = this.models.filter(({ kind }) => kind === "point-tiles");
    if (models.length === 0) {
      context.waiting.notify(
        "no stop of this mission has a point cloud: see `[models]` of the pipeline",
      );
      return;
    }
    if (!this.cloud) {
      element.dataset["points"] = "0";
      const counted = () => {
        element.dataset["points"] = String(this.cloud?.count ?? 0);
        this.readout.textContent = `${this.cloud?.count.toLocaleString("en") ?? 0} points`;
      };
      const failed = (reason: Error) =>
        context.waiting.notify(`points cannot be shown: ${reason.message}`);
      this.cloud = new Cloud(
        models,
        stage.origin,
        choices.pointSize,
        stage.requestFrame,
        counted,
        failed,
      );
      this.cloud.show(choices.stop);
      stage.world.add(this.cloud.group);
    }
    this.cloud.group.visible = choices.points;
    if (!choices.points) this.readout.textContent = "";
    stage.requestFrame();
  }

  private showTies(): void {
    if (this.ties) this.ties.visible = this.choices.ties;
    else
      this.context.waiting.run(async () => {
        const places = await tiePlaces(this.context.layers);
        this.ties = dots(places, this.stage.origin, TIE, 3);
        this.stage.world.add(this.ties);
        this.stage.requestFrame();
      });
    this.stage.requestFrame();
  }

  private listen(): void {
    const { events, state } = this.context;
    let resting: ReturnType<typeof setTimeout> | undefined;
    this.stage.controls.addEventListener("change", () => {
      clearTimeout(resting);
      resting = setTimeout(() => this.reportViewpoint(), REST_MS);
    });
    this.closing.signal.addEventListener("abort", () => clearTimeout(resting));
    const stops = [
      events.pointer.on((pointed) => void this.marker.at(pointed?.point ?? null)),
      events.cursor.on((point) => void this.marker.at(point)),
      state.on("image", (image) => image && this.sights.choose(image.id)),
      events.ellipses.on((factor) => this.route.enlarge(factor)),
    ];
    this.closing.signal.addEventListener("abort", () => stops.forEach((stop) => stop()));
    const handlers = {
      over: (place: Place3 | null) => this.showPlace(place),
      image: (id: string, side: Side) => this.choose(id, side),
      ground: (place: Place3) => this.clicked(place),
      leave: () => this.leave(),
      isOnGround: () => this.flight.isOnGround,
      isMeasuring: () => this.tape.isOn,
    };
    addPointerControls(this.stage, this.terrain, this.sights, handlers, this.closing.signal);
  }

  /** Names an image whose camera was clicked, without covering the camera; opening the image may replace this view. */
  private choose(id: string, side: Side): void {
    this.sights.choose(id);
    this.card.classList.toggle("at-left", side === "right");
    const open = () => openImage(this.context, id);
    this.card.hidden = false;
    this.card.replaceChildren(
      h("img", { src: `images/${encodeURIComponent(id)}/browse.png`, alt: "" }),
      h("button", { type: "button", class: "link", "data-image": id, onclick: open }, id),
    );
  }

  private clicked(place: Place3): void {
    if (this.tape.isOn) this.tape.at(place);
    else identify(this.context, [place[0], place[1]]);
  }

  private leave(): boolean {
    if (!this.tape.isOn) return this.flight.leave();
    this.toggleTape();
    return true;
  }

  private reportShown(isStanding = false): void {
    const { drape, stop } = this.choices;
    this.callbacks.shown({
      drape,
      stop: isStanding ? (this.stop?.stop ?? null) : stop,
      isStanding,
    });
  }

  private reportViewpoint(): void {
    if (this.element.dataset["settled"] !== "true" || this.flight.isOnGround) return;
    const { camera, controls } = this.stage;
    this.callbacks.viewpoint({
      from: this.stage.place(camera.position),
      to: this.stage.place(controls.target),
    });
  }

  private showPlace(place: Place3 | null): void {
    const [east, north, up] = place ?? [];
    this.readout.textContent = place
      ? `east ${fixed(east, 2)}  north ${fixed(north, 2)}  elevation ${fixed(up, 2)} m`
      : "";
    this.context.events.cursor.emit(place ? [place[0], place[1]] : null);
  }
}
