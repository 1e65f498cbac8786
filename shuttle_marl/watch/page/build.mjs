// Builds the page into a folder: node build.mjs FOLDER
import { copyFile, mkdir } from "node:fs/promises";
import { join } from "node:path";
import { build } from "esbuild";

const folder = process.argv[2];
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
  logLevel: "warning",
});
await copyFile("src/index.html", join(folder, "index.html"));
