/** Elements in one expression. */

export type Child = Node | string | null | undefined | false;
export type Attributes = Readonly<
  Record<string, string | number | boolean | null | undefined | ((event: Event) => void)>
>;

/** An element; `on...` attributes are listeners, false and null leave an attribute out. */
export function h<K extends keyof HTMLElementTagNameMap>(
  tag: K,
  attributes: Attributes = {},
  ...children: readonly Child[]
): HTMLElementTagNameMap[K] {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (typeof value === "function") element.addEventListener(name.slice(2), value);
    else if (value === true) element.setAttribute(name, "");
    else if (value !== false && value !== null && value !== undefined)
      element.setAttribute(name, String(value));
  }
  for (const child of children) if (child) element.append(child);
  return element;
}

/** A text whose parts between backticks are code. */
export const withCode = (text: string): readonly Child[] =>
  text.split("`").map((part, k) => (k % 2 === 1 ? h("code", {}, part) : part));

/** A definition list of the known facts. */
export function facts(rows: readonly (readonly [string, Child])[]): HTMLElement {
  const list = h("dl", { class: "facts" });
  for (const [name, value] of rows) if (value) list.append(h("dt", {}, name), h("dd", {}, value));
  return list;
}

const ICONS = {
  ties: "M3 5a2 2 0 1 0 0-.1M13 13a2 2 0 1 0 0-.1M4.5 6.5l7 5",
  plus: "M8 3v10M3 8h10",
  minus: "M3 8h10",
  grid: "M2 2h12v12H2zM2 6h12M2 10h12M6 2v12M10 2v12",
  fit: "M2 6V2h4M10 2h4v4M14 10v4h-4M6 14H2v-4",
  ruler: "M2 11 11 2l3 3-9 9zM5 8l1.5 1.5M7 6l1.5 1.5M9 4l1.5 1.5",
  sun: "M8 5a3 3 0 1 0 0 6 3 3 0 0 0 0-6zM8 1v2M8 13v2M1 8h2M13 8h2M3 3l1.4 1.4M11.6 11.6 13 13M13 3l-1.4 1.4M4.4 11.6 3 13",
  link: "M6.5 9.5l3-3M7 4.5 8.5 3a3 3 0 0 1 4.5 4.5L11.5 9M9 11.5 7.5 13A3 3 0 0 1 3 8.5L4.5 7",
  copy: "M6 6h8v8H6zM10 6V2H2v8h4",
  close: "M4 4l8 8M12 4l-8 8",
  cube: "M8 1.5 14 5v6l-6 3.5L2 11V5zM2 5l6 3.5L14 5M8 8.5v6",
  eyes: "M1.5 8a3 3 0 1 1 6 0 3 3 0 0 1-6 0zM8.5 8a3 3 0 1 1 6 0 3 3 0 0 1-6 0z",
  down: "M8 2v9M4 7.5 8 11.5 12 7.5M3 14h10",
  raise: "M8 13V3M4 7l4-4 4 4",
  lower: "M8 3v10M4 9l4 4 4-4",
  eye: "M1.5 8S4 3.5 8 3.5 14.5 8 14.5 8 12 12.5 8 12.5 1.5 8 1.5 8zM8 6a2 2 0 1 0 0 4 2 2 0 0 0 0-4z",
  flicker: "M2 2h8v8H2zM6 6h8v8H6z",
  search: "M7 2.5a4.5 4.5 0 1 0 0 9 4.5 4.5 0 0 0 0-9zM10.5 10.5 14 14",
  swipe: "M8 1v14M5 5 2 8l3 3M11 5l3 3-3 3",
  panorama: "M1.5 4q6.5 2.5 13 0v8q-6.5-2.5-13 0zM1.5 9.5l3-2 3 2.5 3.5-3.5 3.5 3",
  pin: "M8 14.5S3 9.5 3 6a5 5 0 0 1 10 0c0 3.5-5 8.5-5 8.5zM8 4.3a1.7 1.7 0 1 0 0 3.4 1.7 1.7 0 0 0 0-3.4z",
  image: "M2 3h12v10H2zM2 11l3.5-4 3 3.2L11 8l3 3M11 5.2v.1",
  way: "M3.5 13a1.5 1.5 0 1 0 0-.1M12.5 4.5a1.5 1.5 0 1 0 0-.1M5 13h4.5a2.3 2.3 0 0 0 0-4.6H6.2a2.2 2.2 0 0 1 0-4.4H11",
  note: "M3 2h10v8l-3.5 4H3zM9.5 14v-4H13M5.5 5h5M5.5 7.5h4",
  run: "M8 1.8a6.2 6.2 0 1 0 0 12.4A6.2 6.2 0 0 0 8 1.8zM6.6 5.4 10.8 8l-4.2 2.6z",
  layers: "M8 2 14.5 5.5 8 9 1.5 5.5zM1.5 8.5 8 12l6.5-3.5M1.5 11 8 14.5 14.5 11",
  panel: "M2 3h12v10H2zM10 3v10",
  bookmark: "M4 2h8v12l-4-3.5L4 14z",
  table: "M2 3h12v10H2zM2 6.4h12M2 9.7h12M6.5 3v10",
  expand: "M10 2h4v4M14 2 9.5 6.5M6 14H2v-4M2 14l4.5-4.5",
  options: "M2 4h5M11 4h3M2 8h1M7 8h7M2 12h6M12 12h2M9 2.4v3.2M5 6.4v3.2M10 10.4v3.2",
  tree: "M3 3h4v3H3zM9 10h4v3H9zM5 6v5.5h4",
} as const;

export type IconName = keyof typeof ICONS;

export function icon(name: IconName): SVGSVGElement {
  const svg = document.createElementNS("http://www.w3.org/2000/svg", "svg");
  svg.setAttribute("viewBox", "0 0 16 16");
  svg.setAttribute("aria-hidden", "true");
  svg.setAttribute("class", "icon");
  const path = document.createElementNS("http://www.w3.org/2000/svg", "path");
  path.setAttribute("d", ICONS[name]);
  svg.append(path);
  return svg;
}

export function button(
  label: string,
  image: keyof typeof ICONS,
  onClick: () => void,
  extra: Attributes = {},
): HTMLButtonElement {
  return h(
    "button",
    { type: "button", title: label, "aria-label": label, onclick: onClick, ...extra },
    icon(image),
  );
}
