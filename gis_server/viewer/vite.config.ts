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

/** Modules that the page begins with: those that its first script imports at once, itself or through others. */
function startModules(infoOf: (id: string) => { importedIds: string[] } | null): Set<string> {
  const found = new Set([resolve(import.meta.dirname, "src/main.ts")]);
  for (const id of found) for (const next of infoOf(id)?.importedIds ?? []) found.add(next);
  return found;
}

let start: Set<string> | null = null;

const SERVER = process.env["SOLMAP_SERVER"] ?? "http://127.0.0.1:8765";

export default defineConfig({
  base: "./",
  plugins: [swagger(), precompressed()],
  build: {
    target: "es2022",
    chunkSizeWarningLimit: 800,
    rolldownOptions: {
      output: {
        codeSplitting: {
          groups: [
            {
              // One file, where those that later parts share would be files of their own.
              debugName: "start",
              name: (id, bundle) => {
                start ??= startModules((one) => bundle.getModuleInfo(one));
                return start.has(id) ? "start" : null;
              },
            },
          ],
        },
      },
    },
  },
  server: {
    proxy: Object.fromEntries(
      ["/api", "/tiles", "/images", "/download", "/healthz"].map((path) => [path, SERVER]),
    ),
  },
});
