import { copyFileSync, mkdirSync } from "node:fs";
import { createRequire } from "node:module";
import { dirname, join } from "node:path";
import { defineConfig, type Plugin } from "vite";

const SWAGGER_FILES = ["swagger-ui-bundle.js", "swagger-ui.css"];

/** Puts Swagger UI's two files into `dist/swagger/`, so that the API's page needs no other host. */
function swagger(): Plugin {
  let target = "dist";
  return {
    name: "swagger-files",
    apply: "build",
    configResolved(config) {
      target = join(config.root, config.build.outDir, "swagger");
    },
    closeBundle() {
      const here = createRequire(import.meta.url);
      const source = dirname(here.resolve("swagger-ui-dist/package.json"));
      mkdirSync(target, { recursive: true });
      for (const name of SWAGGER_FILES) copyFileSync(join(source, name), join(target, name));
    },
  };
}

const SERVER = process.env["SOLMAP_SERVER"] ?? "http://127.0.0.1:8765";

export default defineConfig({
  base: "./",
  plugins: [swagger()],
  build: { target: "es2022", chunkSizeWarningLimit: 800 },
  server: {
    proxy: Object.fromEntries(
      ["/api", "/tiles", "/images", "/download", "/healthz"].map((path) => [path, SERVER]),
    ),
  },
});
