/** Saved views: names for links, kept in the browser. The dialog is loaded when it is opened. */

import { button } from "../../page/dom";
import type { Context } from "../../session/context";
import "./views.css";

export function viewsPart({ page, keys, history, state, waiting }: Context): void {
  const show = () =>
    waiting.run(async () => {
      const { viewsDialog } = await import("./list");
      const open = (link: string) => {
        page.closeDialog();
        history.open(link);
      };
      const dialog = viewsDialog({ open, now: () => state.link });
      page.dialog("Saved views", dialog);
      dialog.querySelector("input")?.select();
    });
  page.addTool(button("saved views (b)", "bookmark", show), "views");
  keys.add("b", "save and open views", show);
}
