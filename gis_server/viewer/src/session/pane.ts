/** A pane that is open while its field of the state is not null; its code is loaded when it is opened. */

import { button, type IconName } from "../page/dom";
import type { Pane, Side } from "../page/panes";
import { UnreachableError } from "../server/api";
import type { Context } from "./context";
import type { PaneName, State } from "./state";

type Value<K extends PaneName> = NonNullable<State[K]>;

export interface PaneContent<K extends PaneName> {
  readonly element: HTMLElement;
  /** Instead of the title of the pane; read after every `show`. */
  readonly title?: string;
  /** Shows a value that was not written by this pane. */
  readonly show?: (value: Value<K>) => void | Promise<void>;
  /** Called when it was opened by its button or key. */
  readonly focus?: () => void;
  readonly dispose?: () => void;
}

export interface PaneKind<K extends PaneName> {
  readonly title: string;
  readonly side: Side;
  /** Makes what it shows; `write` sets the field. Null: there is nothing to show, which `load` reports. */
  readonly load: (write: (value: Value<K>) => void) => Promise<PaneContent<K> | null>;
  /** A button and a key that open and close it. */
  readonly tool?: {
    readonly name: string;
    readonly picture: IconName;
    readonly key: string;
    readonly does: string;
    readonly class: string;
    /** State with which it opens. */
    readonly first: () => Value<K>;
  };
}

export function addPane<K extends PaneName>(
  context: Context,
  key: K,
  { title, side, load, tool }: PaneKind<K>,
): void {
  const { page, state, keys, waiting, signal } = context;
  let pane: Pane | null = null;
  let content: PaneContent<K> | null = null;
  let [isLoading, isByHand] = [false, false];

  const close = () => {
    pane = null;
    content?.dispose?.();
    content = null;
    state.set(key, null as State[K]);
  };
  const show = async () => {
    const value = state.get(key) as Value<K> | null;
    if (value === null || !content) return;
    await content.show?.(value);
    pane?.title(content?.title ?? title);
  };
  const open = async () => {
    if (isLoading) return;
    isLoading = true;
    try {
      const made = await load((value) => write(value));
      if (state.get(key) === null || signal.aborted) made?.dispose?.();
      else if (!made) state.set(key, null as State[K]);
      else {
        content = made;
        pane = page.panes.open(key, side, title, made.element, close);
      }
    } catch (reason) {
      if (!(reason instanceof UnreachableError)) state.set(key, null as State[K]);
      throw reason;
    } finally {
      isLoading = false;
    }
    await show();
    if (isByHand) content?.focus?.();
    isByHand = false;
  };
  const pressed = (isOpen: boolean) => toolButton?.setAttribute("aria-pressed", String(isOpen));
  const toggle = () => {
    isByHand = state.get(key) === null;
    if (tool) state.set(key, isByHand ? tool.first() : (null as State[K]));
  };
  const toolButton =
    tool &&
    button(`${tool.name} (${tool.key})`, tool.picture, toggle, {
      class: tool.class,
      "aria-pressed": "false",
    });
  if (tool && toolButton) {
    page.addTool(toolButton, tool.name);
    keys.add(tool.key, tool.does, toggle);
  }
  const write = state.follow(key, (value) => {
    pressed(value !== null);
    if (value === null) pane?.close();
    else waiting.run(content ? show : open);
  });
  signal.addEventListener("abort", () => pane?.close());
}
