/** The dialog that starts a run: its parameters, then the resulting steps, then the request. */

import { facts, h, withCode } from "../../page/dom";
import type { Engine, ParameterSchema, Parameters, RunKind } from "../../server/runs";

type Field = HTMLInputElement | HTMLSelectElement;

/** A parameter of a schema without the alternative that it is left out. */
const plain = (schema: ParameterSchema): ParameterSchema => ({
  ...schema.anyOf?.find(({ type }) => type !== "null"),
  ...schema,
});

function field(name: string, schema: ParameterSchema, isRequired: boolean, given: unknown): Field {
  const { type, pattern, minimum, maximum, items } = plain(schema);
  const choices = items?.enum;
  if (choices) {
    const chosen = Array.isArray(given) ? given : [];
    const options = choices.map((value) =>
      h("option", { value, selected: chosen.includes(value) }, value.replaceAll("_", " ")),
    );
    return h("select", { name, multiple: true, required: true, size: options.length }, ...options);
  }
  if (type === "boolean")
    return h("input", { name, type: "checkbox", ...(given === true ? { checked: true } : {}) });
  const value = given === null || given === undefined ? "" : String(given);
  if (type === "number")
    return h("input", {
      name,
      type: "number",
      min: minimum,
      max: maximum,
      step: "any",
      required: true,
      value,
    });
  return h("input", { name, pattern, required: isRequired, value, autocomplete: "off" });
}

/** The value of one parameter in a form; undefined: it is left out. */
function valueOf(element: Field): unknown {
  if (element instanceof HTMLSelectElement)
    return [...element.selectedOptions].map(({ value }) => value);
  if (element.type === "checkbox") return element.checked;
  if (element.value.trim() === "") return undefined;
  return element.type === "number" ? element.valueAsNumber : element.value.trim();
}

/** The time when a run would begin, in words. */
export function whenText(engine: Engine, going: number): string {
  if (!engine.is_up)
    return "The engine is down: the request is kept until `solmap up` runs on this store.";
  const before = going + engine.queued.length;
  if (before === 0) return "It begins within some seconds.";
  return `It begins when ${before === 1 ? "the run" : `the ${before} runs`} before it ended.`;
}

export const valueText = (value: unknown): string =>
  Array.isArray(value) ? value.join(", ") : value === undefined ? "not given" : String(value);

/** The form; `check` takes its values to the page that confirms. */
export function startForm(
  kind: RunKind,
  given: Parameters,
  check: (parameters: Parameters) => void,
): HTMLElement {
  const { properties, required = [] } = kind.parameters;
  const fields = Object.entries(properties).map(([name, schema]) => ({
    schema,
    element: field(name, schema, required.includes(name), given[name] ?? schema.default),
  }));
  const rows = fields.map(({ schema, element }) =>
    h(
      "label",
      {},
      h("span", {}, schema.title ?? element.name),
      element,
      h("small", { class: "hint" }, schema.description),
    ),
  );
  return h(
    "form",
    {
      class: "start-form",
      onsubmit: (event) => {
        event.preventDefault();
        check(Object.fromEntries(fields.map(({ element }) => [element.name, valueOf(element)])));
      },
    },
    ...rows,
    h("button", { type: "submit", class: "primary" }, "Continue"),
  );
}

/** The resulting steps, and the question whether to start; the reason of a refusal is shown in place. */
export function confirmation(
  sentences: readonly string[],
  values: readonly (readonly [string, string])[],
  label: string,
  confirm: () => Promise<void>,
  back?: () => void,
): HTMLElement {
  const error = h("p", { class: "error", role: "alert" });
  const go = h("button", { type: "button", class: "primary", "data-confirm": true }, label);
  go.addEventListener("click", () => {
    go.disabled = true;
    error.textContent = "";
    confirm().catch((reason: unknown) => {
      go.disabled = false;
      error.textContent = reason instanceof Error ? reason.message : String(reason);
    });
  });
  return h(
    "div",
    { class: "start-form" },
    facts(values),
    ...sentences.map((sentence) => h("p", {}, ...withCode(sentence))),
    error,
    h(
      "div",
      { class: "run-buttons" },
      back ? h("button", { type: "button", onclick: back }, "Back") : null,
      go,
    ),
  );
}
