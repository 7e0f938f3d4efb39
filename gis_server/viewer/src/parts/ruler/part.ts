/** The ruler: a line is drawn on the map, its length and azimuth are told. */

import { measure, measuredText } from "../../map/measure";
import { button } from "../../page/dom";
import type { MapPoint } from "../../server/records";
import type { Context } from "../../session/context";

export function rulerPart({ page, view, keys }: Context): void {
  const tell = (line: readonly MapPoint[]) => {
    page.ruler.textContent = measuredText(measure(line));
  };
  const tool = button("measure a distance (m)", "ruler", () => toggle(), {
    class: "measure",
    "aria-pressed": "false",
  });
  function toggle(on = !view.isMeasuring): void {
    tool.setAttribute("aria-pressed", String(on));
    page.ruler.hidden = !on;
    if (!on) {
      view.stopMeasuring();
      return;
    }
    tell([]);
    view.startMeasuring(tell);
  }
  page.addTool(tool);
  keys.add("m", "measure a distance", () => toggle());
  keys.add("Escape", "stop measuring", () => toggle(false));
}
