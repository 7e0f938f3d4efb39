/** The tools of the image viewer: zoom, contrast, tie points. */

import { button, h } from "../../page/dom";
import { NO_STRETCH, type Stretch } from "../../image/stretch";

export const RESIDUAL_FACTORS = [0, 1, 10, 20, 50, 100, 200, 500] as const;
/** A residual of a tenth of a pixel is drawn five pixels long. */
const FIRST_FACTOR = 50;
const PERCENT = 2;

export interface ControlActions {
  readonly fit: () => void;
  readonly zoom: (factor: number) => void;
  readonly stretch: (stretch: Stretch) => void;
  /** The stretch that leaves out a share of the pixels. */
  readonly automatic: (share: number) => Stretch;
  readonly showTies: (shown: boolean) => void;
  readonly residualFactor: (factor: number) => void;
}

export interface Controls {
  readonly element: HTMLElement;
  /** Back to an unstretched image. */
  reset(): void;
  showTieCount(text: string): void;
  readonly hasTies: boolean;
  readonly factor: number;
}

export function controls(actions: ControlActions): Controls {
  const sliders = {
    low: slider("black", 0, 254, 1, 0),
    high: slider("white", 1, 255, 1, 255),
    gamma: slider("gamma", 0.3, 3, 0.05, 1),
  };
  const entered = (): Stretch => ({
    low: Math.min(Number(sliders.low.value), Number(sliders.high.value) - 1),
    high: Number(sliders.high.value),
    gamma: Number(sliders.gamma.value),
  });
  const set = ({ low, high, gamma }: Stretch) => {
    sliders.low.value = String(low);
    sliders.high.value = String(high);
    sliders.gamma.value = String(gamma);
  };
  const put = (stretch: Stretch) => {
    set(stretch);
    actions.stretch(stretch);
  };
  for (const slider of Object.values(sliders))
    slider.addEventListener("input", () => actions.stretch(entered()));
  const ties = h("input", {
    type: "checkbox",
    class: "show-ties",
    checked: true,
    onchange: () => actions.showTies(ties.checked),
  });
  const factor = h(
    "select",
    {
      class: "residuals",
      "aria-label": "length of residual vectors",
      onchange: () => actions.residualFactor(Number(factor.value)),
    },
    ...RESIDUAL_FACTORS.map((one) =>
      h(
        "option",
        { value: one, selected: one === FIRST_FACTOR },
        one === 0 ? "no residuals" : `residuals × ${one}`,
      ),
    ),
  );
  const count = h("small");
  const label = (name: string, slider: HTMLInputElement) =>
    h("label", { class: "slider" }, h("span", {}, name), slider);
  const element = h(
    "div",
    { class: "image-tools" },
    button("whole image (0)", "fit", actions.fit, { class: "ghost" }),
    button("larger (+)", "plus", () => actions.zoom(1.5), { class: "ghost" }),
    button("smaller (-)", "minus", () => actions.zoom(1 / 1.5), { class: "ghost" }),
    label("black", sliders.low),
    label("white", sliders.high),
    label("gamma", sliders.gamma),
    h(
      "button",
      { type: "button", class: "text auto", onclick: () => put(actions.automatic(PERCENT / 100)) },
      `${PERCENT} %`,
    ),
    h("button", { type: "button", class: "text", onclick: () => put(NO_STRETCH) }, "as is"),
    h("label", { class: "tie-switch" }, ties, "tie points", count),
    factor,
  );
  return {
    element,
    reset: () => set(NO_STRETCH),
    showTieCount: (text) => {
      count.textContent = text;
    },
    get hasTies() {
      return ties.checked;
    },
    get factor() {
      return Number(factor.value);
    },
  };
}

function slider(name: string, min: number, max: number, step: number, value: number) {
  return h("input", { type: "range", class: name, min, max, step, value });
}
