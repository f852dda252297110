/** What went wrong, as the page says it: a sentence, perhaps details, and what to do next. */

import { HmkError, type Kind, type Reason } from "./reader/reasons";

export class Problem extends Error {
  constructor(readonly sentence: string, readonly detail = "", readonly next = "") {
    super([sentence, detail, next].filter((part) => part !== "").join(" "));
    this.name = "Problem";
  }
}

const LEADS: Record<Kind, string> = {
  Corruption: "The file is damaged.",
  InsufficientData: "The file is not complete.",
  Compatibility: "This page cannot read the file.",
  ResourceLimit: "The file asks for more than this page allows.",
  InvalidArgument: "This cannot be shown.",
  Io: "The file cannot be read.",
};

const NEWER = "The file is newer than this page.";

/** The first sentence. */
function headline({ kind, reason, sentence }: HmkError): string {
  const leads: Partial<Record<Reason, string>> = {
    "foreign-file": "This is no .hmk file.", "version-unknown": `${NEWER} ${sentence}`, "transform-unknown": `${NEWER} ${sentence}`,
  };
  return leads[reason] ?? `${LEADS[kind]} ${sentence}`;
}

/** What to say of a file that is not shown beside the model, or in its place. */
export function refusal(name: string, error: unknown): Problem {
  const { sentence, detail, next } = asProblem(error);
  return new Problem(`${name} cannot be shown. ${sentence}`, detail, next);
}

/** The problem behind anything thrown. */
export function asProblem(error: unknown): Problem {
  if (error instanceof Problem) {
    return error;
  }
  if (error instanceof HmkError) {
    const { hint } = error;
    const first = hint.startsWith("hmkcta ") ? "h" : hint.charAt(0).toUpperCase(); // a command is written as it is typed
    const next = hint === "" ? "" : `${first}${hint.slice(1)}.`;
    const detail = error.message.replace(` Next: ${hint}.`, ""); // said in `next`
    return new Problem(headline(error), detail, next);
  }
  const message = error instanceof Error ? error.message : String(error);
  return new Problem("Something unforeseen went wrong on this page.", message, "Reload the page to try again.");
}
