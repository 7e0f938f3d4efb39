import "ol/ol.css";
import "./page/style.css";
import "./page/layout.css";
import { start } from "./app";

const root = document.getElementById("app");
if (!root) throw new Error("index.html has no element with the id app");
void start(root);
