/** What a model is compared with: any file of its shape, whose axes are then the model's. */

import { Problem, asProblem, refusal } from "./problem";
import type { Axis, Metadata } from "./reader/metadata";

/**
 * The metadata of an original as axes of the model: what they are called and what they are for is the model's, as it is
 * of an array that has no names.
 */
export function asOriginal(original: Metadata, axes: Axis[]): Metadata {
  const shape = (of: Axis[]): string => of.map(({ size }) => size).join(" x ");
  if (shape(original.axes) !== shape(axes)) {
    throw new Problem("The original has another shape than the model.",
      `original: found ${shape(original.axes)}, allowed ${shape(axes)}, the model's.`,
      "Give the array that was compressed, or a file made of it, with its axes in this order.");
  }
  const names = new Map(original.axes.map(({ name }, n) => [name, axes[n]!.name]));
  return { ...original, axes, organisation: original.organisation.map((mode) => mode.map((name) => names.get(name)!)) };
}

/** What to say of an original that failed; the model is there all the same. */
export function originalProblem(error: unknown): Problem {
  const problem = asProblem(error);
  const { sentence, detail, next } = problem.sentence.startsWith("The original") ? problem : refusal("The original", problem);
  return new Problem(sentence, detail, `${next} The model is shown without it.`.trimStart());
}
