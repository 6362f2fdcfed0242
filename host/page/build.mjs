// Bundles the page into the folder that is named: node build.mjs FOLDER
import { build } from "esbuild";
import { cp, mkdir } from "node:fs/promises";

const folder = process.argv[2];
if (!folder) throw new Error("usage: node build.mjs FOLDER");
await mkdir(folder, { recursive: true });
await build({
  entryPoints: { page: "src/main.ts", worker: "src/worker.ts" },
  outdir: folder,
  bundle: true,
  minify: true,
  format: "esm",
  target: "es2022",
  legalComments: "linked", // the licences of what is bundled
  logLevel: "warning",
});
for (const file of ["index.html", "page.css"]) await cp(`src/${file}`, `${folder}/${file}`);
await cp("node_modules/uplot/dist/uPlot.min.css", `${folder}/uplot.css`);
