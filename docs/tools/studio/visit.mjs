// Opens a scene file in Foxglove Studio, in a browser without a window, and plays a little of it. Prints what was seen as JSON:
// problems (what Studio says of the file and the layout), topics (number of messages of each), panels (text of each), clock
// (in seconds: before and after it was played), errors (of the page).
//
//   node visit.mjs SCENE LAYOUT PICTURE TIME SCALE [TAB …]
//
// PICTURE is taken at TIME, in milliseconds since 1970 as the scene counts them, of a window of 1500 × 1000 with SCALE pixels for
// each of its own, so that less than 1 draws the same with less work; of every further tab of the court one more, whose
// name ends with that of the tab, of the panel alone. Everything is served on 127.0.0.1; nothing else is asked.
import { once } from "node:events";
import { writeFile } from "node:fs/promises";
import { createServer } from "node:http";
import { basename, dirname, join, resolve } from "node:path";
import { fileURLToPath } from "node:url";
import { setTimeout as pause } from "node:timers/promises";
import puppeteer from "puppeteer-core";
import sirv from "sirv";

// With this, Chromium's libraries (NSS, Expat) come out of the package too, and need not be on the machine.
process.env.AWS_EXECUTION_ENV = "AWS_Lambda_nodejs20.x";
const { default: chromium } = await import("@sparticuz/chromium");

const HERE = dirname(fileURLToPath(import.meta.url));
const LIMIT = 300_000; // for each thing that is waited for [ms]
const SETTLED = 60_000; // until the window is taken as it is [ms]
const PLAYED = 1; // what is played [s of the scene]
const PANELS = "[data-testid^=panel-mouseenter-container]";
const [scene, layout, file, time, scale, ...tabs] = process.argv.slice(2);

// Studio asks for parts of the scene as it needs them.
const setHeaders = (response) => response.setHeader("Accept-Ranges", "bytes");
const folders = {
  "/scene/": dirname(resolve(scene)),
  "/layout/": dirname(resolve(layout)),
  "/page/": join(HERE, "page"),
  "/react/": join(HERE, "node_modules/react/umd"),
  "/react-dom/": join(HERE, "node_modules/react-dom/umd"),
  "/": join(HERE, "node_modules/@foxglove/studio-base/assets"),
};
const handlers = Object.entries(folders).map(([prefix, folder]) => [prefix, sirv(folder, { dev: true, setHeaders })]);

async function serve() {
  const server = createServer((request, response) => {
    const [prefix, handle] = handlers.find(([start]) => request.url.startsWith(start));
    request.url = request.url.slice(prefix.length - 1);
    handle(request, response, () => response.writeHead(404).end());
  });
  server.listen(0, "127.0.0.1");
  await once(server, "listening");
  return server;
}

async function visit(page, origin) {
  const errors = [];
  page.on("pageerror", (error) => errors.push(error.stack ?? String(error)));
  page.on("console", (message) => message.type() === "error" && errors.push(message.text()));
  page.on("response", (answer) => answer.status() >= 400 && errors.push(`${answer.status()} ${answer.url()}`));
  page.setDefaultTimeout(LIMIT);
  const address = new URL("/page/index.html", origin);
  address.searchParams.set("ds", "remote-file");
  address.searchParams.set("ds.url", `${origin}/scene/${encodeURIComponent(basename(scene))}`);
  address.searchParams.set("time", new Date(Number(time)).toISOString());
  address.searchParams.set("layout", `/layout/${encodeURIComponent(basename(layout))}`);
  await page.goto(address.href);

  await page.waitForSelector("button[title='Play']:not([disabled])");
  // Studio lists the topics before it has counted their messages.
  await page.waitForFunction(() => {
    const rows = [...document.querySelectorAll("li")].map((row) => row.innerText.split("\n"));
    return rows.length > 0 && rows.every(([, , count]) => count !== undefined);
  });
  await still(page, textOf);
  const topics = await page.$$eval("li", (rows) =>
    Object.fromEntries(rows.map((row) => row.innerText.split("\n")).map(([name, , count]) => [name, Number(count.replaceAll(",", ""))])),
  );
  const problems = await problemsOf(page);

  // The picture is of the panels alone.
  await page.click("button[aria-label='Dismiss']");
  await page.click("[role='tab'][title='Data source']");
  const picture = Buffer.from(await still(page, pictureOf), "latin1");
  const panels = await page.$$eval(PANELS, (all) => Object.fromEntries(all.map((e) => [e.dataset.testid.split(" ")[1], e.innerText])));

  const further = [];
  for (const tab of tabs) {
    // A click on the tab that is open would edit its title.
    const label = await page.waitForSelector(`[data-testid='toolbar-tab'][title='${tab}']`);
    if (!(await label.$("[data-testid='tab-icon']"))) {
      await label.click();
    }
    await still(page, pictureOf);
    further.push([tab, Buffer.from(await (await page.$("canvas")).screenshot())]);
  }

  const before = await clock(page);
  await page.click("button[title='Play']");
  for (const end = Date.now() + LIMIT; Date.now() < end && (await clock(page)) < before + PLAYED; ) {
    await pause(100);
  }
  return { picture, further, seen: { problems, topics, panels, clock: [before, await clock(page)], errors } };
}

// What stands under the tab of the problems.
async function problemsOf(page) {
  const tab = await page.waitForSelector("::-p-xpath(//*[@role='tab'][starts-with(., 'Problems')])");
  await tab.click();
  await still(page, textOf);
  return tab.evaluate((label) => {
    const tabs = label.parentElement;
    let around = tabs;
    while (around.innerText === tabs.innerText) {
      around = around.parentElement;
    }
    return around.innerText.slice(tabs.innerText.length).trim();
  });
}

const pictureOf = async (page) => Buffer.from(await page.screenshot()).toString("latin1");
const textOf = (page) => page.evaluate(() => document.body.innerText);

// The window when it does not change any more, or after a while: some of what a broken file brings up never stands still.
async function still(page, look) {
  const end = Date.now() + SETTLED;
  const enough = look === textOf ? 3 : 1; // text may wait for a worker, a picture takes seconds by itself
  for (let last, same = 0; ; await pause(1500)) {
    const now = await look(page);
    same = last === now ? same + 1 : 0;
    if (same === enough || Date.now() > end) {
      return now;
    }
    last = now;
  }
}

// What the playback bar says [s since midnight].
async function clock(page) {
  const shown = await page.$$eval("input", (inputs) => inputs.map((input) => input.value).find((value) => value.endsWith("GMT")));
  const [hours, minutes, rest] = shown.split(":");
  return 3600 * (Number(hours) % 12) + 60 * Number(minutes) + parseFloat(rest);
}

const server = await serve();
const browser = await puppeteer.launch({
  executablePath: await chromium.executablePath(),
  headless: "shell",
  args: [...chromium.args, "--lang=en-US"],
  defaultViewport: { width: 1500, height: 1000, deviceScaleFactor: Number(scale) },
  protocolTimeout: LIMIT,
});
try {
  const { picture, further, seen } = await visit(await browser.newPage(), `http://127.0.0.1:${server.address().port}`);
  await writeFile(file, picture);
  for (const [tab, content] of further) {
    await writeFile(file.replace(/\.png$/, `_${tab.toLowerCase()}.png`), content);
  }
  console.log(JSON.stringify(seen, null, 1));
} finally {
  await browser.close();
  server.close();
}
