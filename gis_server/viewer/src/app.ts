/** From an empty page to the map of a mission; retries while the server does not answer or nothing is published. */

import { ApiError, api, UnreachableError } from "./server/api";
import { h } from "./page/dom";
import { eastOf, northOf } from "./page/format";
import type { Mission } from "./server/records";
import { Session } from "./session/session";
import { parseLink } from "./session/state";
import { type Shell, shell } from "./page/shell";

const RETRY_MS = 4000;
const NOTHING_YET =
  "Nothing is published yet: the map opens here when `solmap run` publishes its first layers.";

class App {
  private session: Session | null = null;

  constructor(private readonly page: Shell) {}

  /** Shows what the URL describes now; the open map is kept if it is of that mission. */
  async follow(): Promise<void> {
    if (!this.session?.follow()) await this.open();
  }

  async open(): Promise<void> {
    document.documentElement.dataset["ready"] = "false";
    try {
      const isLoaded = await this.load(parseLink(location.hash).state.m);
      this.page.banner(isLoaded ? null : NOTHING_YET);
      if (!isLoaded) setTimeout(() => void this.retry(), RETRY_MS);
    } catch (reason) {
      if (!(reason instanceof UnreachableError || reason instanceof ApiError)) throw reason;
      this.page.banner(reason.message, () => void this.open());
      if (reason instanceof UnreachableError) setTimeout(() => void this.retry(), RETRY_MS);
    }
  }

  private async retry(): Promise<void> {
    if (this.session) return;
    if (await api.isAlive()) await this.open();
    else setTimeout(() => void this.retry(), RETRY_MS);
  }

  /** Opens the requested mission, or the first one; returns false if there is none. */
  private async load(requested: string | null): Promise<boolean> {
    const begin = await api.start();
    const { missions } = begin;
    const mission = missions.find((item) => item.mission === requested) ?? missions[0];
    if (!mission) return false;
    const { mission: name } = mission;
    const layers = begin.mission === name ? begin.layers : await api.layers(name);
    this.session?.dispose();
    this.page.missionBox.replaceChildren(...this.heading(mission, missions));
    document.title = `${mission.title} – solmap`;
    this.session = new Session(this.page, mission, layers, begin.lastEvent);
    return true;
  }

  private heading(mission: Mission, missions: readonly Mission[]): Node[] {
    const { name, origin, longitude, latitude } = mission.landing;
    const where = h(
      "small",
      { title: mission.landing.source },
      origin ? name : `${name}  ${northOf(latitude)}, ${eastOf(longitude)}`,
    );
    const note = h("small", { class: "note", title: mission.lsl_note }, mission.lsl_note);
    if (missions.length < 2) return [h("b", {}, mission.title), where, note];
    const select = h(
      "select",
      {
        "aria-label": "mission",
        onchange: () => {
          location.hash = `#m=${encodeURIComponent(select.value)}`;
        },
      },
      ...missions.map((item) =>
        h("option", { value: item.mission, selected: item === mission }, item.title),
      ),
    );
    return [select, where, note];
  }
}

export async function start(root: HTMLElement): Promise<void> {
  const app = new App(shell(root));
  window.addEventListener("popstate", () => void app.follow());
  await app.open();
}
