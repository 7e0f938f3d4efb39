/** The parts of the page that the first view of the map does without, in the order of their tabs and tools. */

import { imagesPart } from "../parts/images/part";
import { imageViewPart } from "../parts/image-view/part";
import { stopCardPart } from "../parts/stop-card/part";
import { traversePart } from "../parts/traverse/part";
import { measurePart } from "../parts/measure/part";
import { networkPart } from "../parts/network/part";
import { swipePart } from "../parts/swipe/part";
import { sunPart } from "../parts/sun/part";
import { downloadsPart } from "../parts/downloads/part";
import { panoramaPart } from "../parts/panorama/part";
import { scenePart } from "../parts/scene/part";
import { stereoPart } from "../parts/stereo/part";
import { editorPart } from "../parts/editor/part";
import { annotationsPart } from "../parts/annotations/part";
import { runsPart } from "../parts/runs/part";
import { placeMenuPart } from "../parts/place-menu/part";
import { localFilesPart } from "../parts/local-files/part";
import { tablePart } from "../parts/table/part";
import { viewsPart } from "../parts/views/part";
import { helpPart } from "../parts/help/part";
import { accountPart } from "../parts/account/part";
import { livePart } from "../parts/live/part";
import type { Part } from "./context";

export const LATER_PARTS: readonly Part[] = [
  imagesPart,
  imageViewPart,
  stopCardPart,
  traversePart,
  measurePart,
  networkPart,
  swipePart,
  sunPart,
  downloadsPart,
  panoramaPart,
  scenePart,
  stereoPart,
  editorPart,
  annotationsPart,
  runsPart,
  placeMenuPart,
  viewsPart,
  tablePart,
  localFilesPart,
  helpPart,
  accountPart,
  livePart,
];
