/**
 * The one module that contains the server's URLs.
 *
 * They are relative to the page, which a reverse proxy may serve below the root of its host.
 */

import { authorization } from "./token";
import type {
  Bounds,
  Identified,
  ImageEntry,
  Layer,
  Legend,
  MapPoint,
  Start,
  VectorLayer,
} from "./records";

/** The server answered, but not with the requested content. */
export class ApiError extends Error {
  override readonly name = "ApiError";

  constructor(
    message: string,
    /** Status of HTTP; null if the answer is not understood. */
    readonly status: number | null = null,
  ) {
    super(message);
  }
}

/** The lowest HTTP status of a server error. */
const SERVER_FAILED = 500;

/** The server did not answer. */
export class UnreachableError extends Error {
  override readonly name = "UnreachableError";
}

export interface ImageFilter {
  readonly sol?: number | null;
  readonly stop?: string | null;
}

export interface FeatureCollection {
  readonly type: "FeatureCollection";
  readonly features: readonly unknown[];
}

/** Address of a mission. */
export const of = (mission: string) => `api/missions/${encodeURIComponent(mission)}`;

export function withQuery(path: string, query: Record<string, string | number | null | undefined>) {
  const known = Object.entries(query).filter(([, value]) => value !== null && value !== undefined);
  const text = new URLSearchParams(known.map(([key, value]) => [key, String(value)])).toString();
  return text ? `${path}?${text}` : path;
}

/** A place of the local map in queries, to a tenth of a millimetre. */
export const placeQuery = ([east, north]: MapPoint) => ({
  east: east.toFixed(4),
  north: north.toFixed(4),
});

/** The other end, likewise. */
export const toQuery = (place: MapPoint) => {
  const { east, north } = placeQuery(place);
  return { to_east: east, to_north: north };
};

export const urls = {
  health: () => "healthz",
  start: () => "api/start",
  layers: (mission: string) => `${of(mission)}/layers`,
  identify: (mission: string, place: MapPoint) =>
    withQuery(`${of(mission)}/identify`, placeQuery(place)),
  images: (mission: string, filter: ImageFilter = {}) =>
    withQuery(`${of(mission)}/images`, { sol: filter.sol, stop: filter.stop }),
  solReport: (mission: string, sol: number) => `${of(mission)}/sols/${sol}/report`,
  docs: () => "docs",
};

export function get<T>(url: string, signal?: AbortSignal): Promise<T> {
  return request<T>(url, { headers: authorization(), ...(signal ? { signal } : {}) });
}

/** Sends a request with a body, as JSON. */
export function post<T>(url: string, body: unknown, signal?: AbortSignal): Promise<T> {
  const headers = { "content-type": "application/json", ...authorization() };
  return request<T>(url, {
    method: "POST",
    headers,
    body: JSON.stringify(body),
    ...(signal ? { signal } : {}),
  });
}

async function request<T>(url: string, options: RequestInit): Promise<T> {
  return (await (await answered(url, options)).json()) as T;
}

async function answered(url: string, options: RequestInit): Promise<Response> {
  let response: Response;
  try {
    response = await fetch(url, options);
  } catch (reason) {
    if (options.signal?.aborted) throw reason;
    throw new UnreachableError(`the server does not answer ${url}; is "solmap serve" running?`);
  }
  if (!response.ok) {
    const { status, statusText } = response;
    const text = await response.text();
    const why = reasonIn(text);
    const refusal = status < SERVER_FAILED ? why : null;
    const answer = `${url} was answered with ${status} ${statusText}: ${why ?? text.slice(0, 300)}`;
    throw new ApiError(refusal ?? answer, status);
  }
  return response;
}

/** The sentence in a problem document (RFC 9457), written for the person at the page. */
function reasonIn(text: string): string | null {
  try {
    const { detail } = JSON.parse(text) as { detail?: unknown };
    return typeof detail === "string" ? detail : null;
  } catch {
    return null; // not JSON
  }
}

/** A list, or the list that an object carries under `key`. */
function list<T>(
  answer: readonly T[] | Readonly<Record<string, unknown>>,
  key: string,
): readonly T[] {
  if (Array.isArray(answer)) return answer as readonly T[];
  const inner = (answer as Record<string, unknown>)[key];
  if (Array.isArray(inner)) return inner as readonly T[];
  throw new ApiError(`expected a list of ${key}, got ${JSON.stringify(answer).slice(0, 120)}`);
}

/** URL of the next page of an answer, if there is one (RFC 8288). */
function nextOf(answer: Response, url: string): string | null {
  const link = /<([^>]*)>; rel="next"/.exec(answer.headers.get("Link") ?? "")?.[1];
  if (link === undefined) return null;
  const { pathname, search } = new URL(link, `http://server/${url}`);
  return pathname.slice(1) + search;
}

/** A list from its page at an address to its last. */
async function pages<T>(
  from: string | null,
  key: string,
  signal?: AbortSignal,
): Promise<readonly T[]> {
  const found: T[] = [];
  for (let url = from; url !== null; ) {
    const options = { headers: authorization(), ...(signal ? { signal } : {}) };
    const answer: Response = await answered(url, options);
    found.push(...list<T>(await answer.json(), key));
    url = nextOf(answer, url);
  }
  return found;
}

export const api = {
  /** All missions and the layers of one; the page requests it before its script has loaded. */
  start: async (): Promise<Start> => {
    const answer = await answered(urls.start(), {});
    const known = (await answer.json()) as Omit<Start, "lastEvent">;
    const more = await pages<Layer>(nextOf(answer, urls.start()), "layers");
    const lastEvent = answer.headers.get("Last-Event-ID");
    return { ...known, layers: [...known.layers, ...more], lastEvent };
  },
  layers: (mission: string) => pages<Layer>(urls.layers(mission), "layers"),
  images: (mission: string, filter: ImageFilter, signal?: AbortSignal) =>
    pages<ImageEntry>(urls.images(mission, filter), "images", signal),
  identify: (mission: string, at: MapPoint, signal?: AbortSignal) =>
    get<Identified>(urls.identify(mission, at), signal),
  /** All features of a layer, or those that meet some bounds. */
  features: (layer: VectorLayer, bounds?: Bounds) =>
    get<FeatureCollection>(withQuery(layer.features, { bbox: bounds?.join(",") })),
  /** Features of a layer by their names. */
  featuresNamed: (layer: VectorLayer, names: readonly string[]) =>
    get<FeatureCollection>(
      `${layer.features}?${new URLSearchParams(names.map((name) => ["ids", name]))}`,
    ),
  /** Legend of classes that the layer's file names. */
  legend: ({ provenance }: Layer, query: string) =>
    get<Legend>(provenance.replace(/provenance$/, "legend") + query),
  provenance: (layer: Layer) => get<unknown>(layer.provenance),
  isAlive: async () => {
    try {
      return (await fetch(urls.health())).ok;
    } catch {
      return false;
    }
  },
};
