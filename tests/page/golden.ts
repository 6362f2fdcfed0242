// The golden bytes of proto/vectors.

import { readFileSync } from "node:fs";
import { fileURLToPath } from "node:url";

const ROOT = new URL("../../", import.meta.url);

/** The lines of a file, each cut into its fields. */
export function readVectors(name: string): string[][] {
  const text = readFileSync(new URL(`proto/vectors/${name}`, ROOT), "utf8");
  return text
    .split("\n")
    .filter((line) => line && !line.startsWith("#"))
    .map((line) => line.split(" | "));
}

export function bytesOf(hex: string): Uint8Array {
  return Uint8Array.from(Buffer.from(hex, "hex"));
}

export function hexOf(data: Uint8Array): string {
  return Buffer.from(data).toString("hex");
}

/** The compiled schema of this build. */
export function ownSchema(): Uint8Array {
  const folder = process.env["RUFFINI_NATIVE_DIR"] ?? fileURLToPath(new URL("build/native", ROOT));
  return new Uint8Array(readFileSync(`${folder}/ruffini.desc`));
}

/** Numbers below 2^32 that are always the same ones. */
export function randomNumbers(seed: number): () => number {
  let state = seed >>> 0;
  return () => {
    state = (state + 0x6d2b79f5) >>> 0;
    let t = Math.imul(state ^ (state >>> 15), state | 1);
    t ^= t + Math.imul(t ^ (t >>> 7), t | 61);
    return (t ^ (t >>> 14)) >>> 0;
  };
}
