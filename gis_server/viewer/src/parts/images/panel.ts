/** Original images: the list of a sol or stop, and one image with the values of its label. */

import { facts, h, icon } from "../../page/dom";
import { scopeTitle, time } from "../../page/format";
import type { ImageEntry } from "../../server/records";

/** Rows of the list at once; the filters reach the rest. */
const MOST_ROWS = 300;

const text = (value: unknown) => (value === null || value === undefined ? null : String(value));

export function imageDetail(
  image: ImageEntry,
  open: (id: string) => void,
  enlarge: (image: ImageEntry) => void,
): HTMLElement {
  const partner = image.partner;
  return h(
    "section",
    { class: "image", "data-image": image.id },
    h("h2", {}, image.id),
    image.browse
      ? h(
          "button",
          { type: "button", class: "browse", title: "enlarge", onclick: () => enlarge(image) },
          h("img", { src: image.browse, alt: `image ${image.id}` }),
        )
      : h("p", { class: "hint" }, "This image has no browse image."),
    partner
      ? null
      : h(
          "p",
          { class: "unpaired" },
          `Without partner: ${image.unpaired_because ?? "no reason is recorded"}`,
        ),
    facts([
      ["camera", `${image.instrument}, ${image.eye}`],
      ["sol", text(image.sol)],
      ["stop", `site ${image.site} · drive ${image.drive}`],
      ["local time", text(image.local_solar_time)],
      ["taken", image.start_time ? `${time(image.start_time)} UTC` : null],
      ["product", text(image.product_type)],
      [
        "partner",
        partner
          ? h("button", { type: "button", class: "link", onclick: () => open(partner) }, partner)
          : null,
      ],
    ]),
    image.original
      ? h(
          "div",
          { class: "actions" },
          h(
            "a",
            { class: "text download", href: image.original, download: true },
            icon("down"),
            "original image",
          ),
        )
      : null,
  );
}

export interface ImageListActions {
  readonly open: (id: string) => void;
  readonly hover: (id: string | null) => void;
}

function imageRow(image: ImageEntry, chosen: boolean, actions: ImageListActions): HTMLElement {
  const reason = image.partner ? "" : (image.unpaired_because ?? "no partner");
  return h(
    "li",
    { class: image.partner ? "" : "alone", "aria-current": chosen ? "true" : null },
    h(
      "button",
      {
        type: "button",
        title: reason ? `without partner: ${reason}` : `partner ${image.partner}`,
        onclick: () => actions.open(image.id),
        onmouseenter: () => actions.hover(image.id),
        onmouseleave: () => actions.hover(null),
        onfocus: () => actions.hover(image.id),
      },
      image.browse
        ? h("img", { src: image.browse, alt: "", loading: "lazy", width: 36, height: 36 })
        : null,
      h(
        "span",
        {},
        h("b", {}, image.id),
        h(
          "small",
          {},
          `sol ${image.sol} · ${image.instrument} ${image.eye}${reason ? " · no partner" : ""}`,
        ),
      ),
    ),
  );
}

export function imageList(
  images: readonly ImageEntry[],
  chosen: string | null,
  actions: ImageListActions,
): HTMLElement {
  const rows = images
    .slice(0, MOST_ROWS)
    .map((image) => imageRow(image, image.id === chosen, actions));
  const alone = images.filter((image) => !image.partner).length;
  const hidden = images.length - rows.length;
  return h(
    "div",
    {},
    h("p", { class: "hint count" }, `${images.length} images, ${alone} without partner`),
    h("ul", { class: "images" }, ...rows),
    hidden > 0 ? h("p", { class: "hint" }, `${hidden} more: choose a sol or a stop.`) : null,
  );
}

/** Stops that images were taken from, in the order they were driven to. */
export function stopsOf(
  images: readonly ImageEntry[],
): readonly (readonly [id: string, title: string])[] {
  const stops = new Map(images.map((image) => [image.stop, image] as const));
  return [...stops.values()]
    .sort((a, b) => a.site - b.site || a.drive - b.drive)
    .map((image) => [image.stop, scopeTitle(`site${image.site}-drive${image.drive}`)] as const);
}
