/** What a model may be compared with. */

import { describe, expect, it } from "vitest";
import { axisPlaces } from "../src/decode/element";
import { asOriginal, originalProblem } from "../src/original";
import { Problem } from "../src/problem";
import type { Metadata } from "../src/reader/metadata";
import { loads } from "../src/reader/read";
import { fileOf } from "./files";
import { merged } from "./models";

const { metadata } = loads(fileOf(merged()));

/** The model's metadata with other names and roles. */
function renamed(): Metadata {
  const name = (old: string): string => `${old} of mine`;
  return {
    ...metadata, axes: metadata.axes.map((axis) => ({ ...axis, name: name(axis.name), role: "other" })),
    organisation: metadata.organisation.map((mode) => mode.map(name)),
  };
}

describe("an original", () => {
  it("has the model's axes, whatever it calls them", () => {
    expect(metadata.organisation.some((mode) => mode.length > 1)).toBe(true);
    const found = asOriginal(renamed(), metadata.axes);
    expect(found.axes).toBe(metadata.axes);
    expect(axisPlaces(found)).toEqual(axisPlaces(metadata));
  });

  it("may call them as the model does, in another order", () => {
    const names = metadata.axes.map(({ name }) => name).reverse();
    const swapped = new Map(metadata.axes.map(({ name }, n) => [name, names[n]!]));
    const found = asOriginal({
      ...metadata, axes: metadata.axes.map((axis) => ({ ...axis, name: swapped.get(axis.name)! })),
      organisation: metadata.organisation.map((mode) => mode.map((name) => swapped.get(name)!)),
    }, metadata.axes);
    expect(axisPlaces(found)).toEqual(axisPlaces(metadata));
  });

  it.each([
    ["another size", metadata.axes.map((axis, n) => (n === 0 ? { ...axis, size: axis.size + 1 } : axis))],
    ["an axis more", [...metadata.axes, metadata.axes[0]!]],
  ])("of %s is refused with a sentence", (_, axes) => {
    const refused = (): unknown => asOriginal({ ...metadata, axes }, metadata.axes);
    const shape = (of: typeof axes): string => of.map(({ size }) => size).join(" x ");
    expect(refused).toThrow(Problem);
    expect(refused).toThrow(`original: found ${shape(axes)}, allowed ${shape(metadata.axes)}, the model's. Give the array`);
  });

  it.each<[Error, string]>([
    [new Problem("The original has another shape.", "", "Give another."), "The original has another shape. Give another. The model is shown without it."],
    [new Problem("There is no file."), "The original cannot be shown. There is no file. The model is shown without it."],
    [new Error("odd"), "The original cannot be shown. Something unforeseen went wrong on this page. odd"],
  ])("that fails is named: %s", (error, sentence) => {
    expect(originalProblem(error).message.startsWith(sentence)).toBe(true);
  });
});
