/** Dialog for saving the playback, with its progress. */

import "./playback.css";
import type { Sols } from "../../../map/sols";
import { h } from "../../../page/dom";
import { saveFile } from "../../../page/save";
import type { Context } from "../../../session/context";
import { CREDIT } from "../../../sheet/texts";
import { type Encoder, encoders } from "./encoders";
import { framesOf } from "./frames";

const SECONDS = { least: 0.2, most: 10, first: 1 };

export function recordingDialog(context: Context, steps: readonly Sols[]): HTMLElement {
  const { mission, signal } = context;
  const known = encoders();
  const format = h(
    "select",
    {},
    ...known.map(({ title, ending }) => h("option", { value: ending }, title)),
  );
  const seconds = h("input", {
    type: "number",
    class: "compact-number",
    min: SECONDS.least,
    max: SECONDS.most,
    step: 0.1,
    required: true,
    value: SECONDS.first,
  });
  const credit = h("input", { type: "text", value: CREDIT });
  const status = h("output", { role: "status" });
  const start = h("button", { type: "submit", class: "primary" }, "Save");
  const stopped = new AbortController();
  signal.addEventListener("abort", () => stopped.abort());

  const run = async ({ encode, ending, type }: Encoder) => {
    let count = 0;
    const counted = async function* () {
      for await (const frame of framesOf(context, steps, credit.value)) {
        // A dialog that was closed takes no file.
        if (!element.isConnected || !element.closest("dialog")?.open || stopped.signal.aborted)
          return;
        status.textContent = `frame ${++count} of ${steps.length}`;
        yield frame;
      }
    };
    const bytes = await encode(counted(), seconds.valueAsNumber);
    if (count < steps.length) return;
    saveFile(`${mission.mission}_playback.${ending}`, type, bytes);
    status.textContent = `saved ${count} frames`;
  };
  const submit = (event: Event) => {
    event.preventDefault();
    const encoder = known.find(({ ending }) => ending === format.value);
    if (!encoder) return;
    start.disabled = true;
    run(encoder)
      .catch((reason: unknown) => {
        status.textContent = reason instanceof Error ? reason.message : String(reason);
      })
      .finally(() => {
        start.disabled = false;
      });
  };
  const element = h(
    "form",
    { class: "playback", onsubmit: submit },
    h(
      "p",
      { class: "hint" },
      `One frame a sol (${steps.length}), of the map as it is on the screen.`,
    ),
    h("label", {}, "format", format),
    h("label", {}, "seconds a frame", seconds),
    h("label", {}, "credit", credit),
    known.length > 1
      ? null
      : h("p", { class: "hint" }, "Browsers encode video on pages by https only."),
    h("div", { class: "inline" }, start, status),
  );
  return element;
}
