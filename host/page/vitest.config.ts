// The tests mirror the tree: they are in tests/page of the repository.
import { fileURLToPath } from "node:url";
import { defineConfig } from "vitest/config";

const root = fileURLToPath(new URL("../..", import.meta.url));
export default defineConfig({
  root,
  server: { fs: { allow: [root] } },
  // No test is about time: a busy computer fails none. All files share one context, which takes half the time: each
  // restores the timers and globals that it replaces.
  test: {
    globals: true,
    testTimeout: 120_000,
    include: ["tests/page/**/*.test.ts"],
    cache: false,
    isolate: false,
    pool: "threads",
  },
});
