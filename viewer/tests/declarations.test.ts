/** The module's types for other people's programs, which are written by hand: what they say is what there is. */

import { readFileSync } from "node:fs";
import { join } from "node:path";
import { expect, expectTypeOf, it } from "vitest";
import type * as declared from "../public/hmkcta";
import * as module from "../src/module";

/** What is public of a class. */
type Public<T> = Pick<T, keyof T>;

it("has all that is declared, and declares all that it has", () => {
  expectTypeOf<typeof module.open>().toExtend<typeof declared.open>();
  expectTypeOf<module.Index>().toEqualTypeOf<declared.Index>();
  expectTypeOf<module.Limits>().toEqualTypeOf<declared.Limits>();
  expectTypeOf<module.Slice>().toEqualTypeOf<declared.Slice>();
  expectTypeOf<Public<module.OnGpu>>().toEqualTypeOf<Public<declared.OnGpu>>();
  expectTypeOf<keyof module.Model>().toEqualTypeOf<keyof declared.Model>();
  expectTypeOf<Public<module.Model>>().toExtend<declared.Model>();
  expectTypeOf<module.HmkError>().toExtend<declared.HmkError>();
  expectTypeOf<module.Problem>().toExtend<declared.Problem>();
  const text = readFileSync(join(import.meta.dirname, "..", "public", "hmkcta.d.ts"), "utf-8");
  const values = [...text.matchAll(/^export declare (?:class|const|function) (\w+)/gm)].map(([, name]) => name);
  expect(values.sort()).toEqual(Object.keys(module).sort());
});
