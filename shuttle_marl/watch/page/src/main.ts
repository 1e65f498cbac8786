// Starts the page: connects to its server and shows what it plays.

import "./style.css";
import { App, type Source } from "./app";
import { h } from "./dom";
import { Motion } from "./motion";
import { Connection, type Hello, type RallyFacts } from "./wire";

declare global {
  interface Window {
    viewer?: unknown;
  }
}

const lost = h("div", { class: "notice hidden", role: "alert", style: "position:fixed;bottom:12px" }, "The server does not answer; waiting for it …");
document.body.append(lost);

const address = `${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/ws`;
const server = new Connection(address, (open) => lost.classList.toggle("hidden", open));

const source: Source = {
  async rally(plan, rally, person) {
    const { facts, body } = await server.ask<{ rally: RallyFacts }>("rally", { plan, rally, person });
    return { rally: facts.rally, motion: await Motion.unpack(body) };
  },
  analysis: async (plan, rally, person) => (await server.ask<never>("analysis", { plan, rally, person })).facts,
  styles: async (plan, rally) => (await server.ask<never>("styles", { plan, rally })).facts,
  model: async (athlete) => (await fetch(`${athlete}.glb`)).arrayBuffer(),
};

try {
  const { facts } = await server.ask<Hello>("hello");
  const app = new App(facts, source, false);
  window.viewer = {
    state: () => app.state(),
    seek: (time: number) => (app.seek(time), app.draw()),
    go: (rally: number, stroke: number | null = null) => app.go(rally, stroke),
    key: (key: string) => app.key(key),
    draw: () => app.draw(),
  };
} catch (error) {
  document.body.append(h("p", { role: "alert", style: "padding:20px" }, String((error as Error).message)));
}
