import { copyFileSync, mkdirSync, readdirSync, readFileSync, writeFileSync } from "node:fs";
import { createRequire } from "node:module";
import { dirname, join, resolve } from "node:path";
import { brotliCompressSync, constants, gzipSync } from "node:zlib";
import { defineConfig, type Plugin } from "vite";

const SWAGGER_FILES = ["swagger-ui-bundle.js", "swagger-ui.css"];

/** Puts Swagger UI's two files into `dist/swagger/`, so that the API's page needs no other host. */
function swagger(): Plugin {
  let target = "dist";
  return {
    name: "swagger-files",
    apply: "build",
    configResolved(config) {
      target = resolve(config.root, config.build.outDir, "swagger");
    },
    closeBundle() {
      const here = createRequire(import.meta.url);
      const source = dirname(here.resolve("swagger-ui-dist/package.json"));
      mkdirSync(target, { recursive: true });
      for (const name of SWAGGER_FILES) copyFileSync(join(source, name), join(target, name));
    },
  };
}

/** What is worth compressing, and from what size on. */
const TEXT = /\.(js|css|html|wasm)$/;
const LEAST_BYTES = 1000;

/** Lays compressed files beside the plain ones, so that the server need not compress them for every browser. */
function precompressed(): Plugin {
  let target = "dist";
  return {
    name: "precompressed-files",
    apply: "build",
    enforce: "post",
    configResolved(config) {
      target = resolve(config.root, config.build.outDir);
    },
    closeBundle: {
      order: "post",
      sequential: true,
      handler() {
        for (const entry of readdirSync(target, { recursive: true, withFileTypes: true })) {
          const path = join(entry.parentPath, entry.name);
          if (!entry.isFile() || !TEXT.test(entry.name)) continue;
          const plain = readFileSync(path);
          if (plain.length < LEAST_BYTES) continue;
          const quality = { [constants.BROTLI_PARAM_QUALITY]: 11 };
          writeFileSync(`${path}.br`, brotliCompressSync(plain, { params: quality }));
          writeFileSync(`${path}.gz`, gzipSync(plain, { level: 9 }));
        }
      },
    },
  };
}

const SERVER = process.env["SOLMAP_SERVER"] ?? "http://127.0.0.1:8765";

export default defineConfig({
  base: "./",
  plugins: [swagger(), precompressed()],
  build: { target: "es2022", chunkSizeWarningLimit: 800 },
  server: {
    proxy: Object.fromEntries(
      ["/api", "/tiles", "/images", "/download", "/healthz"].map((path) => [path, SERVER]),
    ),
  },
});
