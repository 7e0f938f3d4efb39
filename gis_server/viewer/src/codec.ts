/** How values are written in the link, and read again. A text that cannot be read is `undefined`, and is reported. */

/** Called with every part of a text that cannot be read. */
export type Broken = (part: string) => void;

export interface Codec<T> {
  readonly read: (text: string, broken: Broken) => T | undefined;
  readonly write: (value: T) => string;
}

/** A value with a key of its own in the link. */
export interface Field<T> {
  /** Value without the key. */
  readonly first: T;
  readonly read: (text: string, broken: Broken) => T | undefined;
  /** Null: the key is left out. */
  readonly write: (value: T) => string | null;
}

/** Left out while it is what it is at first. */
export const initially = <T>(first: T, { read, write }: Codec<T>): Field<T> => ({
  first,
  read,
  write: (value) => (write(value) === write(first) ? null : write(value)),
});

/** A codec whose value is null without the key; the text may be empty. */
export const maybe = <T>({ read, write }: Codec<T>): Field<T | null> => ({
  first: null,
  read,
  write: (value) => (value === null ? null : write(value)),
});

/** An empty text for what it is at first. */
export const or = <T, F>(first: F, { read, write }: Codec<T>): Codec<T | F> => {
  const text = (value: T | F) => (value === first ? "" : write(value as T));
  return {
    read: (from, broken) => (from === "" ? first : read(from, broken)),
    write: text,
  };
};

export function number(
  decimals: number,
  least = Number.NEGATIVE_INFINITY,
  most = Number.POSITIVE_INFINITY,
): Codec<number> {
  return {
    read: (text) => {
      const value = text.trim() === "" ? Number.NaN : Number(text);
      return Number.isFinite(value) && value >= least && value <= most ? value : undefined;
    },
    write: (value) => String(Number(value.toFixed(decimals))),
  };
}

/** A number rounded to some significant digits. */
export const significant = (digits: number, least?: number): Codec<number> => ({
  read: number(0, least).read,
  write: (value) => String(Number(value.toPrecision(digits))),
});

/** Any text but an empty one; what separates values is escaped. */
export const word: Codec<string> = {
  read: (text) => {
    try {
      return decodeURIComponent(text) || undefined;
    } catch {
      return undefined;
    }
  },
  write: (value) => value.replace(/[%~,;]/g, (one) => `%${one.charCodeAt(0).toString(16)}`),
};

export const choice = <T extends string>(names: readonly T[]): Codec<T> => ({
  read: (text) => names.find((name) => name === text),
  write: (name) => name,
});

type Codecs<T> = { readonly [K in keyof T]: Codec<T[K]> };

/** Values one after the other; empty texts at the end are left out. */
export function tuple<T extends readonly unknown[]>(
  separator: string,
  ...parts: Codecs<T>
): Codec<Readonly<T>> {
  const codecs = parts as readonly Codec<unknown>[];
  return {
    read: (text, broken) => {
      const texts = text.split(separator);
      const values = codecs.map(({ read }, k) => read(texts[k] ?? "", broken));
      const isWhole = texts.length <= codecs.length && !values.includes(undefined);
      return isWhole ? (values as unknown as T) : undefined;
    },
    write: (values) => {
      const texts = codecs.map(({ write }, k) => write(values[k]));
      return texts.slice(0, texts.findLastIndex(Boolean) + 1).join(separator);
    },
  };
}

/** A record whose values have names. */
export function record<T extends object>(separator: string, parts: Codecs<T>): Codec<T> {
  const keys = Object.keys(parts) as (keyof T)[];
  const codecs = keys.map((key) => parts[key]) as unknown as readonly Codec<unknown>[];
  const { read, write } = tuple<readonly unknown[]>(separator, ...codecs);
  return {
    read: (text, broken) => {
      const values = read(text, broken);
      return values && (Object.fromEntries(keys.map((key, k) => [key, values[k]])) as T);
    },
    write: (value) => write(keys.map((key) => value[key])),
  };
}

/** Any number of values; those that cannot be read are left out, or make all unreadable where `isWhole`. */
export function list<T>(
  separator: string,
  { read, write }: Codec<T>,
  isWhole = false,
): Codec<readonly T[]> {
  return {
    read: (text, broken) => {
      const all = text.split(separator).filter((one) => isWhole || one !== "");
      const values = all.map((one) => read(one, broken));
      if (isWhole && values.includes(undefined)) return undefined;
      all.forEach((one, k) => values[k] === undefined && broken(one));
      return values.filter((value) => value !== undefined) as T[];
    },
    write: (values) => values.map(write).join(separator),
  };
}

/** Another form of the same value; `to` gives undefined for what has none. */
export const as = <A, B>(
  { read, write }: Codec<A>,
  to: (value: A) => B | undefined,
  from: (value: B) => A,
): Codec<B> => ({
  read: (text, broken) => {
    const value = read(text, broken);
    return value === undefined ? undefined : to(value);
  },
  write: (value) => write(from(value)),
});
