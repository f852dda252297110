/** What the page's address says. */

import { describe, expect, it } from "vitest";
import { Problem } from "../src/problem";
import { fixedSize, given } from "../src/ui/address";

describe("the page's address", () => {
  it("names nothing by an empty parameter", () => {
    const parameters = new URLSearchParams("?file=&original=a.hmk");
    expect(["file", "original", "pixels"].map((name) => given(parameters, name))).toEqual([null, "a.hmk", null]);
  });

  it("fixes the size of the picture", () => {
    expect(fixedSize(null, 8192)).toBe(null);
    expect(fixedSize("640x480", 8192)).toEqual([640, 480]);
    expect(fixedSize("1x8192", 8192)).toEqual([1, 8192]);
  });

  it.each(["0x0", "0x9", "99999x99999", "9x8193", "64", "64x", "-1x5", "1.5x2", "wide"])("has no picture of %s", (pixels) => {
    expect(() => fixedSize(pixels, 8192)).toThrow(Problem);
    expect(() => fixedSize(pixels, 8192)).toThrow(`pixels: found ${pixels}, allowed 1x1 to 8192x8192`);
  });
});
