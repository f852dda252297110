import { defineConfig } from "vitest/config";

// Measurements, which nothing is asserted of: `npm run measure`.
export default defineConfig({ test: { include: ["e2e/**/*.measure.ts"], testTimeout: 600_000, hookTimeout: 180_000 } });
