/** Numbers that are entered before a measurement, as they were last chosen. */

import { h } from "../../page/dom";
import { chosenNumber, type Mode, type NumberField } from "./mode";

export class ChosenNumbers {
  private readonly chosen = new Map<string, number>();

  of({ key, numberFields = [] }: Mode): Record<string, number> {
    return Object.fromEntries(
      numberFields.map((one) => [one.key, chosenNumber(one, this.chosen.get(`${key} ${one.key}`))]),
    );
  }

  choose({ key }: Mode, { key: name }: NumberField, value: number): void {
    this.chosen.set(`${key} ${name}`, value);
  }

  /** A field for each. */
  fields(mode: Mode): HTMLElement {
    const values = this.of(mode);
    const field = (one: NumberField) => {
      const input = h("input", {
        type: "number",
        min: one.least,
        max: one.most,
        step: one.step,
        value: values[one.key],
        "data-number": one.key,
        onchange: () => {
          const value = chosenNumber(one, input.valueAsNumber);
          this.choose(mode, one, value);
          input.value = String(value);
        },
      });
      return h("label", {}, h("span", {}, one.title), input, "m");
    };
    return h("div", { class: "measure-numbers" }, ...(mode.numberFields ?? []).map(field));
  }
}
