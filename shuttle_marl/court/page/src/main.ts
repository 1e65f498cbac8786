// Entry point: connects to the server, or opens the content of a saved page.

import "./style.css";
import { App } from "./app";
import { Connection } from "./connection";
import { h } from "./dom";
import { Motion } from "./motion";
import type { Source, Wanted } from "./rallies";
import { isSite, openReply, openShared, readShared, type Shared, sharedPage, ungzipped } from "./share";
import { Tagging } from "./tag";
import type { Analysis, Hello, MatchReply, RallyFacts, RallyRequest, Styles } from "./wire.gen";
import { say } from "./words";

declare global {
  interface Window {
    viewer?: unknown;
  }
}

function query({ plan, rally, person, tried, friend }: Wanted): Omit<RallyRequest, "have"> {
  if (friend) {
    return { rally, friend: friend.seat };
  }
  return plan ? { plan, rally, person } : { plan: null, rally, tried };
}

async function unpacked({ facts, body }: { facts: { rally: RallyFacts }; body: ArrayBuffer }, before: Motion | null = null) {
  return { rally: facts.rally, motion: await Motion.unpack(body, before) };
}

interface Opened {
  hello: Hello;
  source: Source;
  server?: Connection;
}

/** Source of a page that a server sent. */
async function served(): Promise<Opened> {
  const lost = h("div", { class: "notice hidden", role: "alert", style: "top:auto;bottom:12px" }, say("page.lost"));
  document.body.append(lost);
  const address = `${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/ws`;
  const server = new Connection(address, (open) => lost.classList.toggle("hidden", open));
  const { facts: hello, raw } = await server.ask("hello", {});
  const source: Source = {
    rally: async (wanted, before) => unpacked(await server.ask("rally", { ...query(wanted), have: before !== null }), before),
    analysis: async (wanted) => (await server.ask("analysis", query(wanted))).facts,
    options: async (wanted) => (await server.ask("options", query(wanted))).facts,
    styles: async (wanted) => (await server.ask("styles", query(wanted))).facts,
    match: async (wanted) => (await server.ask("match", { ...query(wanted), partial: false })).facts,
    rating: async ({ points, deviation, volatility }, scores) =>
      (await server.ask("rating", { points, deviation, volatility, scores })).facts,
    friend: async (asked) => (await server.ask("friend", asked)).facts,
    model: fetchModel,
    share: async (wanted, title, hash) => {
      const [script = "", style = ""] = await Promise.all(
        ["watch.js", "watch.css"].map(async (name) => (await fetch(name)).text()),
      );
      const reply = await server.ask("rally", { ...query(wanted), have: false });
      const athletes = new Set(reply.facts.rally.players.map(({ athlete }) => athlete));
      const replies = new Map<string, ArrayBuffer>([
        [`rally ${wanted.rally}`, reply.raw],
        [`analysis ${wanted.rally}`, (await server.ask("analysis", query(wanted))).raw],
      ]);
      if (wanted.plan) {
        replies.set("styles", (await server.ask("styles", query(wanted))).raw);
      }
      const models = new Map(await Promise.all([...athletes].map(async (name) => [name, await fetchModel(name)] as const)));
      return sharedPage({ script, style, hello: raw, replies, models }, title, hash);
    },
  };
  return { hello, source, server };
}

const noPlay = () => Promise.reject(new Error(say("page.cannot_play")));

type Found<F> = Promise<{ facts: F; body: ArrayBuffer }>;

/** Source of stored replies. */
function stored(find: <F>(key: string) => Found<F>, match: (wanted: Wanted) => string, model: Source["model"]): Source {
  return {
    rally: async ({ rally }) => unpacked(await find(`rally ${rally}`)),
    analysis: async ({ rally }) => (await find<Analysis>(`analysis ${rally}`)).facts,
    options: noPlay,
    rating: noPlay,
    styles: async () => (await find<Styles>("styles")).facts,
    match: async (wanted) => (await find<MatchReply>(match(wanted))).facts,
    friend: null,
    model,
    share: null,
  };
}

const MISSING = say("page.not_saved");

/** Source of a saved page. */
async function saved(shared: Shared): Promise<Opened> {
  const { facts } = await openShared<Hello>(shared.hello);
  const saved = Object.keys(shared.replies).filter((key) => key.startsWith("rally "));
  const rallies = 1 + Math.max(...saved.map((key) => Number(key.slice("rally ".length))));
  const hello = facts.recorded ? { ...facts, recorded: { ...facts.recorded, count: rallies } } : { ...facts, rallies };
  const find = <F>(key: string): Found<F> => {
    const reply = shared.replies[key];
    return reply === undefined ? Promise.reject(new Error(MISSING)) : openShared<F>(reply);
  };
  const model = (athlete: string) => ungzipped(shared.models[athlete]!);
  return { hello, source: stored(find, () => "match", model) };
}

/** Source of a site of static files. */
async function site(): Promise<Opened> {
  const find = async <F>(key: string): Found<F> => {
    const reply = await fetch(`replies/${key.replace(" ", "-")}.bin`);
    if (!reply.ok) {
      throw new Error(MISSING);
    }
    return openReply<F>(await reply.arrayBuffer());
  };
  const { facts: hello } = await find<Hello>("hello");
  const match = ({ plan, rally }: Wanted) => `match ${plan ? 0 : rally}`;
  return { hello, source: stored(find, match, fetchModel) };
}

const fetchModel = async (athlete: string) => (await fetch(`${athlete}.glb`)).arrayBuffer();

const shared = readShared();
try {
  const { hello, source, server } = await (shared ? saved(shared) : isSite() ? site() : served());
  if (hello.tag && server) {
    const tagging = new Tagging(hello, hello.tag, server);
    window.viewer = { state: () => tagging.facts };
  } else {
    const app = new App(hello, source);
    window.viewer = {
      state: () => app.state(),
      seek: (time: number) => {
        app.seek(time);
        app.draw();
      },
      go: (rally: number, stroke: number | null = null) => app.go(rally, stroke),
      key: (key: string) => app.key(key),
      draw: () => app.draw(),
      held: (time: number) => app.held(time),
      windowAt: (x: number, y: number) => app.stage?.windowAt(x, y) ?? null,
    };
  }
} catch (error) {
  document.body.append(h("p", { role: "alert", style: "padding:20px" }, (error as Error).message));
}
