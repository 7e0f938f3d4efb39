/** A guided tour of the page, fetched when it is started: the purpose of each part in turn. */

import { type DriveStep, driver } from "driver.js";
import "driver.js/dist/driver.css";
import "./tour.css";

/** The element that a step points to, its title and its text. */
const STEPS = [
  [
    ".left",
    "Layers",
    "What is on the map lies in “Active layers”, the uppermost first. Below it every layer of the mission, the merged map and each stop can be switched on. The sliders keep a range of sols.",
  ],
  [
    "div.map",
    "Map",
    "Drag to move, wheel or + and − to zoom. A click identifies a place: coordinates, values with their standard deviation, the images that see it. A right click offers more. Numbers along the edges are metres east and north of the landing site.",
  ],
  [
    ".toolbar",
    "Tools",
    "Measure, attribute table, panorama, stereo pair and 3D view. Panes stand side by side and share one cursor with the map.",
  ],
  [
    ".map-legend",
    "Legend",
    "What the colours and symbols of all layers on the map mean. Drawn larger: ellipses of one standard deviation.",
  ],
  [
    ".search-box",
    "Search",
    "Sols, stops, images and coordinates: latitude and longitude, metres, site and rover frames. The key / leads here.",
  ],
  [
    ".tabs",
    "Analysis",
    "Traverse against telemetry, measurements, the image network, comparison of layers, the sun, downloads, annotations and runs.",
  ],
  [
    ".help",
    "Help",
    "All keys, and this tour again. The address of the page is a link to exactly what you see; back and forward undo and redo.",
  ],
] as const;

const isVisible = (element: Element | null): element is HTMLElement =>
  element instanceof HTMLElement && element.checkVisibility();

/** Shows the visible parts in turn; calls `ended` at the end or when it is closed. */
export function showTour(ended: () => void): void {
  const steps = STEPS.flatMap(([selector, title, description]): DriveStep[] => {
    const element = document.querySelector(selector);
    return isVisible(element) ? [{ element, popover: { title, description } }] : [];
  });
  driver({
    steps,
    animate: !matchMedia("(prefers-reduced-motion: reduce)").matches,
    showProgress: true,
    progressText: "{{current}} of {{total}}",
    prevBtnText: "Back",
    nextBtnText: "Next",
    doneBtnText: "Done",
    disableActiveInteraction: true,
    popoverClass: "tour",
    // The library makes them banner and contentinfo of the whole page.
    onPopoverRender: ({ title, footer }) => {
      for (const part of [title, footer]) part.setAttribute("role", "none");
    },
    onDestroyed: ended,
  }).drive();
}
