/** The page and its document name the same keys. */

import { readFileSync } from "node:fs";
import { join } from "node:path";
import { expect, it } from "vitest";
import { KEYS } from "../src/ui/keys";

it("has the keys of the document", () => {
  const text = readFileSync(join(import.meta.dirname, "..", "..", "docs", "viewer.md"), "utf-8");
  const [, table] = /\| keys \| what they do \|\n\| --- \| --- \|\n((?:\|.*\n)+)/.exec(text) ?? [];
  const rows = (table ?? "").trim().split("\n").map((row) => row.split("|").slice(1, 3).map((cell) => cell.trim()));
  expect(Object.fromEntries(rows)).toEqual(KEYS);
});
