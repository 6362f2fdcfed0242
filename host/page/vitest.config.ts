// The tests mirror the tree: they are in tests/page of the repository.
import { fileURLToPath } from "node:url";
import { defineConfig } from "vitest/config";

const root = fileURLToPath(new URL("../..", import.meta.url));
export default defineConfig({
  root,
  server: { fs: { allow: [root] } },
  test: { globals: true, include: ["tests/page/**/*.test.ts"], cache: false },
});
