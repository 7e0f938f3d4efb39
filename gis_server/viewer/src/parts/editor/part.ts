/** The tool that opens the tie-point editor over the map. */

import { button } from "../../page/dom";
import { api } from "../../server/api";
import type { Context } from "../../session/context";
import type { Editor } from "./editor";

export function editorPart(context: Context): void {
  const { page, mission, waiting, keys, account, events } = context;
  let editor: Editor | null = null;

  const open = async () => {
    const [{ Editor }, images] = await Promise.all([
      import("./editor"),
      api.images(mission.mission, {}),
    ]);
    const left = images.filter(({ eye, partner }) => eye === "left" && partner);
    const [one, other] = [...new Set(left.map(({ stop }) => stop))].slice(-2);
    if (!one || !other) {
      waiting.notify("Ties join stops: this mission has stereo pairs of one stop at most.");
      return;
    }
    const opened = new Editor(context, left, [one, other]);
    editor = opened;
    page.bench.open("Tie points between stops", opened.element, () => {
      editor = null;
    });
    opened.element.querySelector("canvas")?.focus();
    await opened.start();
  };
  const toggle = () => {
    if (page.bench.isOpen) page.bench.close();
    else waiting.run(open);
  };
  page.addTool(
    button("edit tie points between stops (t)", "ties", toggle, { class: "editor-tool" }),
    "tie points",
  );
  keys.add("t", "edit tie points between stops", toggle);
  keys.add("Escape", "close the editor", () => page.bench.close());
  account.changed.on(() => editor?.redraw());
  events.serverEvent.on(({ kind, document }) => {
    if (kind === "edits.changed" && document.mission === mission.mission)
      waiting.run(async () => editor?.loadSaved());
  });
}
