/** What the page says of an error. */

import { describe, expect, it } from "vitest";
import { asProblem, refusal } from "../src/problem";
import { foreign } from "../src/reader/lookalikes";
import { fault } from "../src/reader/reasons";

const bytes = (text: string): Uint8Array => Uint8Array.from(text, (letter) => letter.charCodeAt(0));

describe("what is said to do next", () => {
  it.each([
    ["\x93NUMPY\x01\0", "hmkcta compress it, or give the .hmk file that was made of it."],
    ["\x1f\x8b\x08", "Unpack it: gunzip."],
    ["PK\x03\x04", "Unpack the .hmk file in it, or hmkcta compress it, or give the .hmk file that was made of it."],
  ])("begins as a sentence, but for the command's name: of %j", (start, next) => {
    const problem = asProblem(foreign(bytes(start)));
    expect(problem.next).toBe(next);
    expect(problem.detail).not.toContain("Next:");
  });

  it("is nothing where there is no advice", () => {
    expect(asProblem(fault("json-syntax", "header")).next).toBe("");
  });
});

it("names a file that is refused", () => {
  const { sentence, next } = refusal("a.png", foreign(bytes("\x89PNG\r\n\x1a\n")));
  expect(sentence).toBe("a.png cannot be shown. This is no .hmk file.");
  expect(next).toContain("hmkcta compress it");
});
