/** The attribute table in the dock below the map. Its code is loaded when it is opened. */

import { button } from "../../page/dom";
import type { Context } from "../../session/context";
import type { TableView } from "./view";

const KEY = "table";

export function tablePart(context: Context): void {
  const { page, keys, link, waiting } = context;
  let isOpen = false;
  let shown: TableView | null = null;
  const tool = button("attribute table (a)", "table", () => toggle(), {
    class: "table-tool",
    "aria-pressed": "false",
  });
  const closed = () => {
    isOpen = false;
    shown?.dispose();
    shown = null;
    link.write(KEY, null);
    tool.setAttribute("aria-pressed", "false");
  };
  const open = (text: string | null) => {
    isOpen = true;
    tool.setAttribute("aria-pressed", "true");
    waiting.run(async () => {
      const { TableView: View } = await import("./view");
      if (!isOpen || shown) return;
      shown = new View(context, (state) => link.write(KEY, state));
      page.below.open("Attribute table", shown.element, closed);
      shown.follow(text);
      shown.focus();
    });
  };
  const toggle = () => {
    if (!isOpen) open(null);
    else if (shown) page.below.close();
    else closed();
  };
  link.follow(KEY, (text) => {
    if (shown && text !== null) shown.follow(text);
    else if ((text !== null) !== isOpen) text === null ? toggle() : open(text);
  });
  page.addTool(tool);
  keys.add("a", "attribute table", toggle);
}
