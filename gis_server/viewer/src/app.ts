/** From an empty page to the map of a mission; retries while the server does not answer. */

import { ApiError, api, UnreachableError } from "./server/api";
import { h } from "./page/dom";
import { eastOf, northOf } from "./page/format";
import type { Mission } from "./server/records";
import { Session } from "./session/session";
import { parseLink } from "./session/state";
import { type Shell, shell } from "./page/shell";

const RETRY_MS = 4000;

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
      await this.load(parseLink(location.hash).state.m);
      this.page.banner(null);
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

  private async load(requested: string | null): Promise<void> {
    const begin = await api.start();
    const { missions } = begin;
    const mission = missions.find((item) => item.mission === requested) ?? missions[0];
    if (!mission) {
      throw new ApiError(
        "the store holds no mission yet: run `solmap run DOWNLINK_DIR --store STORE`",
      );
    }
    const { mission: name } = mission;
    const layers = begin.mission === name ? begin.layers : await api.layers(name);
    this.session?.dispose();
    this.page.missionBox.replaceChildren(...this.heading(mission, missions));
    document.title = `${mission.title} – solmap`;
    this.session = new Session(this.page, mission, layers, begin.lastEvent);
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
