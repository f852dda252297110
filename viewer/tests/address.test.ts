/** What the page's address says. */

import { describe, expect, it } from "vitest";
import { Problem } from "../src/problem";
import { fixedSize, given, takeToken } from "../src/ui/address";

/** A tab at an address: what it is then, and what the page made of it. */
function visited(address: string, kept: Map<string, string> | null): { token: string | null; address: string } {
  const url = new URL(address);
  const tab = { state: null, replaceState: (_: unknown, __: string, to: string) => { url.href = new URL(to, url).href; } };
  const keep = (): Storage => {
    if (kept === null) {
      throw new DOMException("no storage", "SecurityError");
    }
    const [getItem, setItem] = [(name: string) => kept.get(name) ?? null, (name: string, value: string) => kept.set(name, value)];
    return { getItem, setItem } as unknown as Storage;
  };
  const token = takeToken(new URL(url) as unknown as Location, tab as unknown as History, keep);
  return { token, address: url.href };
}

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

  it("loses its token, which the tab keeps", () => {
    const kept = new Map<string, string>();
    const page = "http://127.0.0.1:8000/";
    expect(visited(`${page}?token=abc&file=files/a%2520b%2Bc.hmk&original=o.hmk#x`, kept))
      .toEqual({ token: "abc", address: `${page}?file=files/a%2520b%2Bc.hmk&original=o.hmk#x` });
    expect(visited(`${page}?file=files/a.hmk`, kept)).toEqual({ token: "abc", address: `${page}?file=files/a.hmk` });
    expect(visited(`${page}?file=a.hmk&token=new`, kept)).toEqual({ token: "new", address: `${page}?file=a.hmk` });
    expect(visited(page, kept).token).toBe("new");
    expect(visited(`${page}?token=abc`, null)).toEqual({ token: "abc", address: page });
  });

  it("has no token on a host that gives its files to everybody", () => {
    for (const kept of [new Map<string, string>(), null]) {
      const address = "https://example.org/wood/?file=wood.hmk";
      expect(visited(address, kept)).toEqual({ token: null, address });
    }
  });
});
