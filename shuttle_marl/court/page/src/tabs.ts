// Tabs as described by the WAI-ARIA authoring practices: one tab stop, arrows move, Enter or space opens.

import { h } from "./dom";

export interface Tabs<Name extends string> {
  element: HTMLElement;
  show(name: Name): void;
}

/**
 * @param text what a tab is called.
 * @param panel id of the panel that all tabs control.
 * @param open opens a tab.
 */
export function tabList<Name extends string>(
  label: string,
  names: readonly Name[],
  text: (name: Name) => string,
  panel: string,
  open: (name: Name) => void,
): Tabs<Name> {
  const tabs = names.map((name) =>
    h(
      "button",
      { role: "tab", id: `tab-${name}`, "aria-selected": "false", "aria-controls": panel, onclick: () => open(name) },
      text(name),
    ),
  );
  const focus = (at: number) => {
    tabs.forEach((tab, i) => (tab.tabIndex = i === at ? 0 : -1));
    tabs[at]!.focus();
  };
  const element = h("div", { class: "tabs", role: "tablist", "aria-label": label }, ...tabs);
  element.addEventListener("keydown", (event) => {
    const at = tabs.indexOf(event.target as HTMLButtonElement);
    const next = { ArrowLeft: at - 1, ArrowRight: at + 1, Home: 0, End: tabs.length - 1 }[event.key];
    if (at >= 0 && next !== undefined) {
      focus((next + tabs.length) % tabs.length);
      event.preventDefault();
      event.stopPropagation();
    }
  });
  return {
    element,
    show: (name) => {
      tabs.forEach((tab, i) => {
        tab.setAttribute("aria-selected", String(names[i] === name));
        tab.tabIndex = names[i] === name ? 0 : -1;
      });
    },
  };
}
