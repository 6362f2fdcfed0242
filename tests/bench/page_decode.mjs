// Time of the page's decoder on one message: node page_decode.mjs SCHEMA FILE N, prints the median of N in nanoseconds.
import { readFile } from "node:fs/promises";
import { createRequire } from "node:module";
import { fileURLToPath } from "node:url";

const PAGE = fileURLToPath(new URL("../../host/page/", import.meta.url));
const { build } = createRequire(`${PAGE}package.json`)("esbuild");
const PROGRAM = `
  import { fieldOf } from "./src/results";
  import { Decoder } from "./src/wire/framing";
  import { Schema } from "./src/wire/schema";
  export { Decoder, fieldOf, Schema };
`;

const bundle = await build({
  stdin: { contents: PROGRAM, resolveDir: PAGE, loader: "ts" },
  bundle: true,
  write: false,
  format: "esm",
  target: "es2022",
});
const code = Buffer.from(bundle.outputFiles[0].contents).toString("base64");
const { Decoder, fieldOf, Schema } = await import(`data:text/javascript;base64,${code}`);

const [, , schemaFile, file, runs] = process.argv;
const schema = new Schema(await readFile(schemaFile));
const bytes = new Uint8Array(await readFile(file));
const times = [];
for (let i = 0; i < Number(runs); i++) {
  const begin = process.hrtime.bigint();
  const [frame] = [...new Decoder().feed(bytes)];
  const field = fieldOf(schema.decode(frame.type, frame.payload));
  times.push(Number(process.hrtime.bigint() - begin));
  if (field.force.length === 0) throw new Error("no field");
}
console.log(times.sort((a, b) => a - b)[times.length >> 1].toFixed(1));
