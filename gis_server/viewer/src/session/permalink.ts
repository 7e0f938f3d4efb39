/**
 * View and layers in the URL's fragment: `#m=mer2&at=12.5,-3.25,0.02&on=scope/kind,scope/kind*0.6&sol=156`.
 *
 * `at` is east, north, metres a pixel, and the turn of the map in degrees if it is turned. Layers are named without their
 * digest, so a link shows the newest product.
 */

export interface Place {
  readonly east: number;
  readonly north: number;
  readonly resolution: number;
  readonly rotationDeg: number;
}

export interface Permalink {
  readonly mission: string | null;
  readonly place: Place | null;
  /** Opacity by id of the layers that are on; null if the link does not say. */
  readonly on: ReadonlyMap<string, number> | null;
  readonly sol: number | null;
}

const tidy = (value: number, decimals: number) => String(Number(value.toFixed(decimals)));

function parsePlace(text: string | null): Place | null {
  if (!text) return null;
  const [east, north, resolution, rotationDeg = 0] = text.split(",").map(Number);
  if (east === undefined || north === undefined || resolution === undefined) return null;
  if (![east, north, resolution, rotationDeg].every(Number.isFinite) || resolution <= 0)
    return null;
  return { east, north, resolution, rotationDeg };
}

function parseOn(text: string | null): ReadonlyMap<string, number> | null {
  if (text === null) return null;
  const entries = text.split(",").filter(Boolean);
  return new Map(
    entries.map((entry): [string, number] => {
      const [id = "", opacity] = entry.split("*");
      const value = opacity === undefined ? 1 : Number(opacity);
      return [id, Number.isFinite(value) ? Math.min(1, Math.max(0, value)) : 1];
    }),
  );
}

export function parsePermalink(fragment: string): Permalink {
  const query = new URLSearchParams(fragment.replace(/^#/, ""));
  const sol = query.get("sol");
  return {
    mission: query.get("m"),
    place: parsePlace(query.get("at")),
    on: parseOn(query.get("on")),
    sol: sol !== null && /^\d+$/.test(sol) ? Number(sol) : null,
  };
}

export function formatPermalink({ mission, place, on, sol }: Permalink): string {
  const parts: string[] = [];
  if (mission) parts.push(`m=${encodeURIComponent(mission)}`);
  if (place) {
    const numbers = [tidy(place.east, 3), tidy(place.north, 3), tidy(place.resolution, 6)];
    if (Math.abs(place.rotationDeg) > 0.05) numbers.push(tidy(place.rotationDeg, 1));
    parts.push(`at=${numbers.join(",")}`);
  }
  if (on) {
    const layers = [...on].map(([id, opacity]) => (opacity < 1 ? `${id}*${tidy(opacity, 2)}` : id));
    parts.push(`on=${layers.join(",")}`);
  }
  if (sol !== null) parts.push(`sol=${sol}`);
  return `#${parts.join("&")}`;
}
