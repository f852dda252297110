/** What saved pictures are called. */

import { expect, it } from "vitest";
import { pictureName } from "../src/ui/save";

it.each([
  ["wood.hmk", "wood.png"], ["Wood.HMK", "Wood.png"], ["wood.old.hmk", "wood.old.png"], ["wood", "wood.png"],
  ["of\\a/b.hmk", "b.png"], [".hmk", "hmkcta.png"], ["https://example.org/", "hmkcta.png"],
])("a picture of %s is %s", (file, picture) => {
  expect(pictureName(file)).toBe(picture);
});
