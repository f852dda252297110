import { defineConfig } from "vitest/config";

// One browser, one test after the other: the adapter is a program on the same cores.
export default defineConfig({
  test: { include: ["e2e/**/*.e2e.ts"], testTimeout: 120_000, hookTimeout: 180_000, fileParallelism: false },
});
