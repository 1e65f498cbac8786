// Starts Foxglove Studio in the page with the layout that its address names; the library is a bundle that puts its names into window.
"use strict";

// Keeps layouts as long as the page is open.
class Layouts {
  #namespaces = new Map();
  #of(namespace) {
    if (!this.#namespaces.has(namespace)) {
      this.#namespaces.set(namespace, new Map());
    }
    return this.#namespaces.get(namespace);
  }
  async list(namespace) {
    return [...this.#of(namespace).values()];
  }
  async get(namespace, id) {
    return this.#of(namespace).get(id);
  }
  async put(namespace, layout) {
    this.#of(namespace).set(layout.id, layout);
    return layout;
  }
  async delete(namespace, id) {
    this.#of(namespace).delete(id);
  }
  async importLayouts() {}
}

class Settings {
  #values = new Map([
    ["colorScheme", "dark"],
    ["language", "en"],
    ["telemetry.telemetryEnabled", false],
    ["telemetry.crashReportingEnabled", false],
  ]);
  #listeners = new Map();
  get(key) {
    return this.#values.get(key);
  }
  async set(key, value) {
    this.#values.set(key, value);
    for (const listener of this.#listeners.get(key) ?? []) {
      listener(value);
    }
  }
  addChangeListener(key, listener) {
    this.#listeners.set(key, (this.#listeners.get(key) ?? new Set()).add(listener));
  }
  removeChangeListener(key, listener) {
    this.#listeners.get(key)?.delete(listener);
  }
}

async function start() {
  window.overwriteFetch();
  await window.waitForFonts();
  await window.initI18n();
  const layouts = new Layouts();
  const data = await (await fetch(new URLSearchParams(location.search).get("layout"))).json();
  await layouts.put("local", {
    id: "scene",
    name: "scene",
    permission: "CREATOR_WRITE",
    baseline: { data, savedAt: new Date().toISOString() },
  });
  localStorage.setItem("studio.profile-data", JSON.stringify({ currentLayoutId: "scene" }));
  const app = React.createElement(window.App, {
    deepLinks: [location.href],
    dataSources: [new window.RemoteDataSourceFactory()],
    appConfiguration: new Settings(),
    layoutStorage: layouts,
    extensionLoaders: [],
    enableGlobalCss: true,
    enableLaunchPreferenceScreen: false,
  });
  ReactDOM.render(app, document.getElementById("root"));
}

start();
