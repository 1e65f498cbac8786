// Elements of the page. Text is always set as text, never as markup.

export type Child = Node | string | null | undefined | false;
type Props = Record<string, string | number | boolean | null | undefined | ((event: Event) => void)>;

/** Creates an element with attributes, listeners (`onclick`, …) and children. */
export function h<K extends keyof HTMLElementTagNameMap>(
  tag: K,
  props: Props = {},
  ...children: Child[]
): HTMLElementTagNameMap[K] {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(props)) {
    if (typeof value === "function") {
      element.addEventListener(name.slice(2), value);
    } else if (value === true) {
      element.setAttribute(name, "");
    } else if (value !== false && value !== null && value !== undefined) {
      element.setAttribute(name, String(value));
    }
  }
  element.append(
    ...children.filter((child): child is Node | string => child !== null && child !== undefined && child !== false),
  );
  return element;
}

const SVG = "http://www.w3.org/2000/svg";

/** Creates an SVG element. */
export function s(tag: string, attributes: Record<string, string | number> = {}, ...children: (Node | string)[]): SVGElement {
  const element = document.createElementNS(SVG, tag);
  for (const [name, value] of Object.entries(attributes)) {
    element.setAttribute(name, String(value));
  }
  element.append(...children);
  return element;
}

/** A number from 0 to 1 in percent; only 0 is shown as 0 %, and only 1 as 100 %. */
export function percent(p: number): string {
  if (p > 0 && p < 0.005) {
    return "<1 %";
  }
  if (p > 0.995 && p < 1) {
    return ">99 %";
  }
  return `${Math.round(100 * p)} %`;
}

/** A change in percentage points, with its sign. */
export function signed(p: number): string {
  const points = Math.round(100 * p);
  return points > 0 ? `+${points} %` : points < 0 ? `−${-points} %` : "0 %";
}

/** Words with a capital at the start. */
export function capitalised(words: string): string {
  return words.charAt(0).toUpperCase() + words.slice(1);
}

/** Colour of a side, on panels and overlays. */
export function sideColour(seat: number): string {
  return seat ? "var(--b)" : "var(--a)";
}

/** Whether the viewer asks for less motion. */
export function still(): boolean {
  return matchMedia("(prefers-reduced-motion: reduce)").matches;
}

export function replaceChildren(parent: Element, ...children: Child[]): void {
  parent.replaceChildren(
    ...children.filter((child): child is Node | string => child !== null && child !== undefined && child !== false),
  );
}

/** Resolves when the browser has shown the next picture; where it shows none, as in a hidden tab, after a second. */
export function nextPicture(): Promise<void> {
  return new Promise((resolve) => {
    requestAnimationFrame(() => requestAnimationFrame(() => resolve()));
    setTimeout(resolve, 1000);
  });
}

/** What the browser keeps under a name, if it fits. */
export function kept<T>(name: string, otherwise: T, fits: (found: T) => boolean): T {
  try {
    const found = JSON.parse(localStorage.getItem(name) ?? "null") as T | null;
    return found !== null && fits(found) ? found : otherwise;
  } catch {
    return otherwise; // nothing is stored, or not by this page
  }
}

export function keep(name: string, what: unknown): void {
  try {
    localStorage.setItem(name, JSON.stringify(what));
  } catch {
    // A browser that stores nothing.
  }
}
