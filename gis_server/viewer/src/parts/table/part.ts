/** The attribute table below the map. Its code is loaded when it is opened. */

import type { Context } from "../../session/context";
import { addPane } from "../../session/pane";
import { ALL_ROWS } from "../../session/state";

export function tablePart(context: Context): void {
  addPane(context, "table", {
    title: "Attribute table",
    side: "below",
    tool: {
      name: "attribute table",
      picture: "table",
      key: "a",
      does: "attribute table",
      class: "table-tool",
      first: () => ({ subject: "stops" as const, ...ALL_ROWS }),
    },
    load: async (write) => {
      const { TableView } = await import("./view");
      return new TableView(context, write);
    },
  });
}
