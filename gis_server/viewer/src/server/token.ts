/** The token for writing: kept until the tab is closed, sent only to this server. */

const KEY = "solmap-token";

export const token = {
  read: (): string | null => sessionStorage.getItem(KEY),
  keep: (text: string): void => sessionStorage.setItem(KEY, text),
  forget: (): void => sessionStorage.removeItem(KEY),
};

/** Header of a request that writes; empty until somebody has signed in. */
export function authorization(): Record<string, string> {
  const text = token.read();
  return text ? { authorization: `Bearer ${text}` } : {};
}
