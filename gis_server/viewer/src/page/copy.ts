/** Copying to the clipboard, also where the browser allows scripts no clipboard: on plain http. */

import { h } from "./dom";
import type { Shell } from "./shell";

async function isCopied(text: string): Promise<boolean> {
  try {
    await navigator.clipboard.writeText(text);
    return true;
  } catch {
    return isCopiedBySelection(text); // no clipboard on plain http, or not allowed
  }
}

function isCopiedBySelection(text: string): boolean {
  const field = h("textarea", { class: "off-screen", readonly: true, "aria-hidden": "true" });
  field.value = text;
  const before = document.activeElement;
  document.body.append(field);
  field.select();
  const isDone = document.execCommand("copy");
  field.remove();
  if (before instanceof HTMLElement) before.focus();
  return isDone;
}

/** Copies a text and confirms it; if that is not allowed, shows the text for copying manually. */
export async function copyText(
  page: Pick<Shell, "toast" | "dialog">,
  what: string,
  text: string,
): Promise<void> {
  if (await isCopied(text)) {
    page.toast(`${what} copied`);
    return;
  }
  const field = h("textarea", { class: "to-copy", rows: 3, readonly: true, "aria-label": what });
  field.value = text;
  page.dialog(`Copy the ${what.toLowerCase()} with Ctrl+C`, field);
  field.select();
}
