/** What shows as white, by the type of the source. */

import { expect, it } from "vitest";
import { codedWhite, isCoded, whiteOf } from "../src/render/white";
import { LIGHTFIELD, VOLUME, axis, shown } from "./made";

it.each([["bool", 1], ["uint8", 255], ["uint16", 65535], ["int8", null], ["int16", null], ["uint32", null], ["uint64", null], ["float16", null], ["float32", null]])(
  "of pictures of %s is %s", (dtype, white) => {
    for (const kind of ["svbrdf", "lightfield"] as const) {
      expect(whiteOf(dtype, kind, LIGHTFIELD)).toBe(white);
    }
    expect(whiteOf(dtype, "generic", [axis("y", 4, "space"), axis("x", 4, "space"), axis("rgb", 3, "channel")])).toBe(white);
    expect([whiteOf(dtype, "volume", VOLUME), whiteOf(dtype, "generic", VOLUME)], "of measured volumes").toEqual([null, null]);
  });

it("makes light of 8-bit materials", () => {
  expect(["uint8", "uint16", "float32"].map((dtype) => [isCoded(dtype), codedWhite(dtype)])).toEqual([[true, 255], [false, 65535], [false, 1]]);
  expect(shown("svbrdf", [...LIGHTFIELD.slice(2), axis("light", 3, "light")], [], "uint8").state.surface.coded).toBe(true);
});
