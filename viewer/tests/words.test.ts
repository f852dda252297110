/** Numbers as the page says them. */

import { expect, it } from "vitest";
import { formatBytes } from "../src/bytes";
import { plain } from "../src/ui/controls";

it("says sizes as hmkcta info does", () => {
  expect([800, 1024, 36_904, 23_373_000, 5 * 2 ** 30].map(formatBytes)).toEqual(["800 B", "1.00 KiB", "36.04 KiB", "22.29 MiB", "5.00 GiB"]);
});

it("says numbers shortly, with an exponent where they have many zeros", () => {
  const numbers = [0, -3, 4096, 0.12345, -0.00000149, 1.5, 123456.7, 1e7, 0.000999, Infinity];
  expect(numbers.map((each) => plain(each))).toEqual(
    ["0", "-3", "4096", "0.123", "-1.49e-6", "1.5", "123000", "1.00e7", "9.99e-4", "Infinity"]);
  expect(plain(0.12345, 4)).toBe("0.1235");
});
