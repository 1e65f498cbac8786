// Builds the page into a folder: node build.mjs FOLDER
import { copyFile, mkdir, readFile } from "node:fs/promises";
import { join } from "node:path";
import { build } from "esbuild";

const folder = process.argv[2];
/** Groups of texts that only the reports use, as `Catalogue` in words.ts says. */
const REPORTS = ["scout", "match", "drills", "tactics", "habit"];
const texts = {
  name: "texts of the page",
  setup: (plan) =>
    plan.onLoad({ filter: /languages[/\\]\w+\.json$/ }, async ({ path }) => {
      const groups = Object.entries(JSON.parse(await readFile(path, "utf8"))).filter(([name]) => !REPORTS.includes(name));
      return { contents: JSON.stringify(Object.fromEntries(groups)), loader: "json" };
    }),
};
await mkdir(folder, { recursive: true });
await build({
  entryPoints: { watch: "src/main.ts" },
  outdir: folder,
  bundle: true,
  minify: true,
  format: "esm",
  charset: "utf8",
  target: "es2022",
  legalComments: "eof",
  plugins: [texts],
  logLevel: "warning",
});
await copyFile("src/index.html", join(folder, "index.html"));
