/** The signed-in account. */

import { get } from "./api";

export interface Account {
  readonly name: string;
  readonly role: "viewer" | "analyst" | "operator";
  readonly ends_at: string | null;
}

const RANKS = ["viewer", "analyst", "operator"] as const;

/** Whether an account has a role or a higher one. */
export const mayAct = (account: Account | null, role: Account["role"]): boolean =>
  account !== null && RANKS.indexOf(account.role) >= RANKS.indexOf(role);

export const whoami = () => get<Account>("api/account");
