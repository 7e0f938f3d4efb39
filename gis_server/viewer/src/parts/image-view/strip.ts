/** The images that show the place under the cursor, with the place marked in each: seen, hidden or not known. */

import { h } from "../../page/dom";
import { metres } from "../../page/format";
import type { Seen, Sight } from "../../server/projection";

const MOST = 12;
const THUMB_PX = 88;

const SIGHTS: Readonly<Record<Sight, string>> = {
  visible: "seen",
  hidden: "hidden by ground",
  unknown: "not known if seen",
};

/** Position of a mark on a thumbnail, percent of its sides. */
export function markAt(
  { sample, line }: Pick<Seen, "sample" | "line">,
  [samples, lines]: readonly [number, number],
): readonly [left: number, top: number] {
  return [(100 * (sample + 0.5)) / samples, (100 * (line + 0.5)) / lines];
}

export function seenText(seen: Seen): string {
  const flat = seen.incidence_deg !== null && seen.incidence_deg > 80 ? ", grazing" : "";
  return `${seen.image}: ${SIGHTS[seen.sight]}, ${metres(seen.range_m)} away${flat}`;
}

interface Thumb {
  readonly element: HTMLElement;
  update(seen: Seen, isChosen: boolean): void;
}

/** Thumbnails of images that still see the place stay, so that they do not flicker under the pointer. */
export class Strip {
  readonly element = h("div", { class: "strip" });
  private readonly heading = h("p", { class: "hint" });
  private readonly list = h("ul", { "aria-label": "images that show the place" });
  private readonly thumbs = new Map<string, Thumb>();

  constructor(private readonly open: (image: string) => void) {
    this.element.append(this.heading, this.list);
    this.show([], null);
  }

  show(seen: readonly Seen[], chosen: string | null): void {
    const isSeen = seen.filter(({ sight }) => sight === "visible").length;
    this.heading.textContent =
      seen.length === 0
        ? "Point at mapped ground: the images that show it appear here."
        : `${isSeen} of ${seen.length} images that look there see the place; dashed: hidden, or not known.`;
    const shown = seen.slice(0, MOST).map((one) => {
      const thumb = this.thumbs.get(one.image) ?? this.make(one);
      thumb.update(one, one.image === chosen);
      return thumb.element;
    });
    this.list.replaceChildren(...shown);
  }

  private make({ image, browse }: Seen): Thumb {
    const mark = h("i", { class: "mark" });
    const thumbnail = h("img", { src: browse, alt: "", width: THUMB_PX, height: THUMB_PX });
    const button = h(
      "button",
      { type: "button", onclick: () => this.open(image) },
      thumbnail,
      mark,
    );
    const element = h("li", { "data-image": image }, button);
    let seen: Seen | null = null;
    const place = () => {
      if (!seen || thumbnail.naturalWidth === 0) return;
      const [left, top] = markAt(seen, [thumbnail.naturalWidth, thumbnail.naturalHeight]);
      mark.style.left = `${left}%`;
      mark.style.top = `${top}%`;
    };
    thumbnail.addEventListener("load", place);
    const update = (one: Seen, isChosen: boolean) => {
      seen = one;
      place();
      mark.className = `mark ${one.sight}`;
      element.dataset["sight"] = one.sight;
      element.toggleAttribute("aria-current", isChosen);
      button.title = seenText(one);
      button.setAttribute("aria-label", seenText(one));
    };
    const thumb = { element, update };
    this.thumbs.set(image, thumb);
    return thumb;
  }
}
