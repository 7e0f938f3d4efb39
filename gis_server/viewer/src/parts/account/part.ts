/** Signing in with a token, required for writing: edits of ties, annotations, runs. */

import { h } from "../../page/dom";
import { ApiError } from "../../server/api";
import { whoami } from "../../server/account";
import { token } from "../../server/token";
import type { Context } from "../../session/context";

export function accountPart(context: Context): void {
  const { page, account, waiting } = context;
  const button = h("button", { type: "button", class: "text sign-in" });
  const draw = () => {
    const who = account.value;
    button.textContent = who ? `${who.name} (${who.role})` : "Sign in";
    button.title = who ? "sign out" : "sign in with a token, to edit ties, annotate and start runs";
  };
  button.addEventListener("click", () => {
    if (account.value) {
      token.forget();
      account.set(null);
    } else page.dialog("Sign in", form(context));
  });
  account.changed.on(draw);
  page.accountBox.append(button);
  draw();
  if (token.read()) waiting.run(() => recognise(context));
}

/** Requests the owner of the stored token; deletes a revoked token. */
async function recognise({ account }: Context): Promise<void> {
  try {
    account.set(await whoami());
  } catch (reason) {
    if (!(reason instanceof ApiError)) throw reason;
    token.forget();
    throw reason;
  }
}

function form(context: Context): HTMLElement {
  const field = h("input", {
    type: "password",
    autocomplete: "off",
    spellcheck: "false",
    required: true,
    placeholder: "solmap_…",
    "aria-label": "token",
  });
  const error = h("p", { class: "error", role: "alert" });
  const submit = async () => {
    token.keep(field.value.trim());
    try {
      await recognise(context);
      context.page.closeDialog();
    } catch (reason) {
      error.textContent = reason instanceof Error ? reason.message : String(reason);
    }
  };
  return h(
    "form",
    {
      class: "sign-in-form",
      onsubmit: (event) => {
        event.preventDefault();
        void submit();
      },
    },
    h(
      "p",
      { class: "hint" },
      "A token is made with ",
      h("code", {}, "solmap token add NAME --role analyst"),
      " by who runs this server. It is kept until this tab is closed.",
    ),
    h(
      "div",
      { class: "inline" },
      field,
      h("button", { type: "submit", class: "primary" }, "Sign in"),
    ),
    error,
  );
}
