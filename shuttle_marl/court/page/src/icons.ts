// Icons as SVG paths in a 16 by 16 view box.

import { s } from "./dom";

const PATHS: Record<string, string> = {
  first: "M2 2h2v12H2zM14 2v12L5 8z",
  back: "M12 2v12L3 8z",
  play: "M4 2l10 6-10 6z",
  pause: "M3 2h4v12H3zM9 2h4v12H9z",
  forward: "M4 2l9 6-9 6z",
  last: "M2 2l9 6-9 6zM12 2h2v12h-2z",
  close: "M3 1 8 6 13 1l2 2-5 5 5 5-2 2-5-5-5 5-2-2 5-5-5-5z",
  replay: "M8 3V0L3 4l5 4V5a4 4 0 1 1-4 4H2a6 6 0 1 0 6-6z",
};

export function icon(name: string): SVGElement {
  return s("svg", { viewBox: "0 0 16 16", "aria-hidden": "true" }, s("path", { d: PATHS[name]! }));
}
