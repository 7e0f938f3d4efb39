/** Events of the server (`/api/events`), and the connection that receives them. */

import { withQuery } from "./api";

/** Every kind there is; documents carry what is listed, and `at`. */
export interface ServerEvents {
  "layers.published": { readonly mission: string; readonly layers: readonly string[] };
  "images.ingested": { readonly mission: string; readonly images: number };
  "mission.changed": { readonly mission: string };
  "run.changed": {
    readonly id: string;
    readonly kind: string;
    readonly subject: string;
    readonly state: string;
    readonly stage: string | null;
    readonly done: number;
    readonly total: number;
  };
  "edits.changed": { readonly mission: string; readonly edit: number; readonly kind: string };
  "requests.changed": {
    readonly request: number;
    readonly state: string;
    readonly answer?: string;
  };
  "engine.changed": { readonly is_up: boolean };
  /** Events were missed: everything must be requested again. */
  reload: Readonly<Record<string, never>>;
}
export type Kind = keyof ServerEvents;
export type ServerEvent = {
  [K in Kind]: { readonly kind: K; readonly document: ServerEvents[K] };
}[Kind];

const KINDS: readonly Kind[] = [
  "layers.published",
  "images.ingested",
  "mission.changed",
  "run.changed",
  "edits.changed",
  "requests.changed",
  "engine.changed",
  "reload",
];
/** The first event, which has only the number of the last one. */
const FIRST_EVENT = "hello";

export const eventsUrl = (mission: string, since: string | null) =>
  withQuery("api/events", { mission, since });

/**
 * Receives events until `signal` is aborted, from the one after `since`, the last that the page has. The browser reconnects by
 * itself and sends the last event that it received; where the server answers with an error it gives up, and is
 * restarted here. `connected` is called when the connection opens or is lost.
 */
export function listen(
  mission: string,
  since: string | null,
  signal: AbortSignal,
  receive: (one: ServerEvent) => void,
  connected: (isConnected: boolean) => void = () => undefined,
): void {
  let source: EventSource | null = null;
  let again: ReturnType<typeof setTimeout> | undefined;
  let lastId = since;
  const open = () => {
    source = new EventSource(eventsUrl(mission, lastId));
    source.addEventListener(FIRST_EVENT, ({ lastEventId }) => (lastId = lastEventId));
    for (const kind of KINDS) {
      source.addEventListener(kind, ({ data, lastEventId }) => {
        lastId = lastEventId;
        const document: unknown = JSON.parse(String(data));
        receive({ kind, document } as ServerEvent);
      });
    }
    source.onopen = () => connected(true);
    source.onerror = () => {
      if (!signal.aborted) connected(false);
      if (source?.readyState !== EventSource.CLOSED) return;
      again = setTimeout(open, AGAIN_MS);
    };
  };
  signal.addEventListener("abort", () => {
    clearTimeout(again);
    source?.close();
  });
  open();
}

const AGAIN_MS = 10_000;
