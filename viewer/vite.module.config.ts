import { defineConfig } from "vite";

// One file without dependencies beside the page, for pages of other people (docs/web.md).
export default defineConfig({
  build: {
    lib: { entry: "src/module/index.ts", formats: ["es"], fileName: () => "hmkcta.js" },
    outDir: "../python/hmkcta/viewer_page",
    emptyOutDir: false,
    target: "es2023",
  },
});
