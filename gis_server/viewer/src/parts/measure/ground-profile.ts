/** The profile of a drawn line in the dock below the map: elevation or slope, tied to the map's cursor both ways. */

import { chart, type ChartOptions } from "../../page/chart";
import { h } from "../../page/dom";
import { measured } from "../../page/format";
import type { Profile } from "../../server/measure";
import type { MapPoint } from "../../server/records";
import type { Context } from "../../session/context";
import { decimalsOn } from "./quantities";
import { LineLink } from "../../session/line-link";

type Drawn = Omit<ChartOptions, "onCursor">;
type Shown = "elevation" | "slope";
const COLOUR = "#c2571b";

/** What the chart of a profile shows. */
export function profileOptions(profile: Profile, shown: Shown): Drawn {
  const { distance_m: xs, layers, slope_baseline_m } = profile;
  const known = profile.elevation_m.filter((value) => value !== null);
  const decimals = decimalsOn(layers);
  const from = layers.length > 0 ? `From ${layers.map(({ id }) => id).join(", ")}. ` : "";
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

export class GroundProfile {
  private readonly link: LineLink;
  private line: readonly MapPoint[] = [];
  private readonly room = h("div", { class: "ground-profile-chart" });
  private shown: Shown = "elevation";

  constructor(private readonly context: Context) {
    this.link = new LineLink(context);
  }

  open(title: string, corners: readonly MapPoint[], profile: Profile): void {
    this.line = corners;
    const select = h(
      "select",
      {
        "aria-label": "what the profile shows",
        onchange: () => {
          this.shown = select.value === "slope" ? "slope" : "elevation";
          this.draw(profile);
        },
      },
      ...(["elevation", "slope"] as const).map((name) =>
        h("option", { value: name, selected: name === this.shown }, name),
      ),
    );
    const body = h("div", { class: "ground-profile" }, select, this.room);
    this.context.page.below.open(title, body, () => this.link.off());
    this.draw(profile);
  }

  /** Opens a chart that has only one thing to show. */
  openChart(title: string, corners: readonly MapPoint[], options: Drawn): void {
    this.line = corners;
    const body = h("div", { class: "ground-profile" }, this.room);
    this.context.page.below.open(title, body, () => this.link.off());
    this.drawChart(options);
  }

  private draw(profile: Profile): void {
    this.drawChart(profileOptions(profile, this.shown));
  }

  private drawChart(options: Drawn): void {
    const drawn = chart({ ...options, onCursor: this.link.tell });
    this.link.on(this.line, drawn);
    this.room.replaceChildren(drawn.element);
  }
}
