/** The ruler: a line is drawn on the map, its length and azimuth are told. */

import { measure, measuredText } from "../../map/measure";
import { Sketch } from "../../map/sketch";
import { button } from "../../page/dom";
import type { MapPoint } from "../../server/records";
import type { Context } from "../../session/context";

export function rulerPart({ page, view, keys }: Context): void {
  let sketch: Sketch | null = null;
  const tell = (line: readonly MapPoint[]) => {
    page.ruler.textContent = measuredText(measure(line));
  };
  const tool = button("measure a distance (m)", "ruler", () => toggle(), {
    class: "measure",
    "aria-pressed": "false",
  });
  function toggle(on = sketch === null): void {
    tool.setAttribute("aria-pressed", String(on));
    page.ruler.hidden = !on;
    sketch?.stop();
    sketch = on ? new Sketch(view, "line", { change: tell, end: tell }) : null;
    if (on) tell([]);
  }
  page.addTool(tool);
  keys.add("m", "measure a distance", () => toggle());
  keys.add("Escape", "stop measuring", () => toggle(false));
}
