/** The profile of a drawn line below the map: elevation or slope, tied to the map's cursor both ways. */

import { chart, type ChartOptions } from "../../page/chart";
import { h } from "../../page/dom";
import { measured } from "../../page/format";
import type { Profile } from "../../server/measure";
import type { Context } from "../../session/context";
import { LineLink } from "../../session/line-link";
import type { State } from "../../session/state";
import type { Measurement } from "./export";
import { decimalsOn, sourcesText } from "./quantities";

type Drawn = Omit<ChartOptions, "onCursor">;
type ProfileShown = NonNullable<State["profile"]>;
const COLOUR = "#c2571b";

/** Options of the chart of a profile. */
export function profileOptions(profile: Profile, shown: ProfileShown["shown"]): Drawn {
  const { distance_m: xs, layers, slope_baseline_m } = profile;
  const known = profile.elevation_m.filter((value) => value !== null);
  const decimals = decimalsOn(layers);
  const from = layers.length > 0 ? `From ${sourcesText(layers)}. ` : "";
  const heightText = (value: number) =>
    measured(value, "m", profile.sigma_m[profile.elevation_m.indexOf(value)], 10 ** -decimals);
  const range =
    known.length > 0
      ? `Elevation ${heightText(Math.min(...known))} to ${heightText(Math.max(...known))}. `
      : "Nothing was measured here. ";
  const x = { title: "distance", unit: "m", decimals };
  const share = `${Math.round((100 * known.length) / Math.max(1, xs.length))} % measured; the band is one sigma.`;
  if (shown === "slope")
    return {
      title: "Slope along the line",
      summary: `${from}Slope over ${slope_baseline_m} m, positive uphill. ${share}`,
      x,
      y: { title: "slope", unit: "°", decimals: 1 },
      series: [
        {
          name: "slope",
          colour: COLOUR,
          xs,
          ys: profile.slope_deg,
          sigma: profile.slope_sigma_deg,
        },
      ],
    };
  return {
    title: "Profile of the ground",
    summary: `${from}${range}${share}`,
    x,
    y: { title: "elevation", unit: "m", decimals },
    series: [
      { name: "elevation", colour: COLOUR, xs, ys: profile.elevation_m, sigma: profile.sigma_m },
    ],
  };
}

/** A measurement along a line; null while it is not there. */
type Along = Pick<Measurement, "number" | "corners" | "found"> | null;

export class GroundProfile {
  readonly element = h("div", { class: "ground-profile" });
  title = "Profile";
  private readonly link: LineLink;

  constructor(
    context: Context,
    private readonly of: (number: number) => Promise<Along>,
    private readonly write: (value: ProfileShown) => void,
  ) {
    this.link = new LineLink(context);
  }

  async show({ of, shown }: ProfileShown): Promise<void> {
    const along = await this.of(of);
    const profile = along?.found.profile;
    const options = profile ? profileOptions(profile, shown) : along?.found.chart;
    if (!along || !options) return;
    this.title = `${profile ? "Profile" : options.title} ${along.number}`;
    const drawn = chart({ ...options, onCursor: this.link.setCursor });
    this.link.on(along.corners, drawn);
    this.element.replaceChildren(
      ...(profile ? [this.choice({ of, shown })] : []),
      h("div", { class: "ground-profile-chart" }, drawn.element),
    );
  }

  dispose(): void {
    this.link.off();
  }

  private choice({ of, shown }: ProfileShown): HTMLElement {
    const choose = () => {
      const value = { of, shown: select.value === "slope" ? "slope" : "elevation" } as const;
      this.write(value);
      void this.show(value);
    };
    const select = h(
      "select",
      { "aria-label": "what the profile shows", onchange: choose },
      ...(["elevation", "slope"] as const).map((name) =>
        h("option", { value: name, selected: name === shown }, name),
      ),
    );
    return select;
  }
}
