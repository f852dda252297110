/** The built page and module: small, and nothing in them that a security policy would stop. */

import { existsSync, readFileSync, readdirSync } from "node:fs";
import { join } from "node:path";
import { gzipSync } from "node:zlib";
import { describe, expect, it } from "vitest";

const PAGE = join(import.meta.dirname, "..", "..", "python", "hmkcta", "viewer_page");
const MOST = 150_000; // bytes, gzipped
const MOST_MODULE = 31_000;

const built = existsSync(join(PAGE, "index.html"));
if (!built && process.env["CI"] === "true") {
  throw new Error("the page is not built: make page");
}

describe.runIf(built)("bundle", () => {
  const files = built ? (readdirSync(PAGE, { recursive: true, withFileTypes: true })
    .filter((entry) => entry.isFile()).map((entry) => join(entry.parentPath, entry.name))) : [];

  it("is small", () => {
    const bytes = files.reduce((sum, file) => sum + gzipSync(readFileSync(file)).length, 0);
    expect(bytes).toBeLessThan(MOST);
    expect(bytes).toBeGreaterThan(10_000);
  });

  it("has a module of one small file", async () => {
    const path = join(PAGE, "hmkcta.js");
    expect(gzipSync(readFileSync(path)).length).toBeLessThan(MOST_MODULE);
    expect(readFileSync(path, "utf-8")).not.toMatch(/^import |\bimport\(/m);
    const module = await import(path) as object;
    expect(Object.keys(module).sort()).toEqual(["HmkError", "Model", "Problem", "open"]);
  });

  it("loads only what lies beside it, by relative addresses", () => {
    const html = readFileSync(join(PAGE, "index.html"), "utf-8");
    const addresses = [...html.matchAll(/(?:src|href)="([^"]*)"/g)].map(([, address]) => address);
    expect(addresses.filter((address) => !/^(\.\/assets\/|data:,$)/.test(address ?? ""))).toEqual([]);
    expect(html).not.toMatch(/<script(?![^>]*src=)|<style|style=|\son\w+=/);
  });

  it("evaluates no text as code", () => {
    const scripts = files.filter((file) => file.endsWith(".js")).map((file) => readFileSync(file, "utf-8")).join("\n");
    expect(scripts).not.toMatch(/\beval\(|new Function\(/);
  });
});
