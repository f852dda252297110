/** Every reason for which a file is refused: the codes and sentences of `docs/format.md`, part II. */

export type Kind = "Compatibility" | "Corruption" | "InsufficientData" | "InvalidArgument" | "ResourceLimit" | "Io";

const CORRUPTION = {
  "header-crc": "The CRC-32 of the header is not the one stored before it.",
  "header-bytes": "The header holds a control character or an upper-case digit in a \\u escape.",
  "json-encoding": "The header is not UTF-8, or a string in it is half a surrogate pair.",
  "json-syntax": "The header is not JSON, or has white space outside strings.",
  "json-duplicate-key": "An object names a key twice.",
  "json-number": "A number is NaN, infinite, or a whole number beyond 2^53 - 1.",
  "field-missing": "A required field is absent.",
  "field-unknown": "A field is not in this specification.",
  "field-type": "A field has the wrong JSON type.",
  "field-value": "A field has a value that is not allowed.",
  organisation: "The modes do not list every axis exactly once.",
  "trailing-bytes": "Bytes follow the last section.",
  "section-crc": "The CRC-32 of a section is not the one stored behind it.",
  "code-end": "The code of a run ends before all its nodes are read, or does not end with them.",
  "code-range": "A whole number in the code of a run is larger than any that may be there.",
  "node-shape": "A node has K above C, or is a cut into one part.",
  "level-bounds": "C, K and R of a stage in the header are not the largest of its nodes.",
  "run-count": "A run has more or fewer cells, numbers or children than the header says.",
  "child-count": "The children of the nodes of a stage are not as many as the next stage has nodes.",
  "row-count": "The children of the nodes of a stage do not own as many rows as the next stage has.",
  "cluster-range": "A row names a cluster or part that its node does not have.",
  "cluster-order": "The clusters of a row are not distinct and ascending.",
  "not-finite": "A stored number is NaN or infinite.",
  "value-range": "The stored numbers are so large that decoding them can overflow.",
};

const RESOURCE_LIMIT = {
  "header-too-large": "The header is larger than the limit.",
  "json-depth": "JSON is nested deeper than the limit.",
  "json-string": "A string is longer than the limit.",
  "order-limit": "The tensor has more modes than the limit.",
  "axes-limit": "The source array has more axes than the limit.",
  "elements-limit": "The source array has more elements than the limit.",
  "levels-limit": "There are more stages than the limit.",
  "nodes-limit": "There are more nodes than the limit.",
  "clusters-limit": "C of a mode is above the limit.",
  "mixture-limit": "K of a mode is above the limit.",
  "rank-limit": "R of a mode is above the limit, or above the size of an undecomposed mode.",
  "level-cost-limit": "The product of K R over the decomposed modes of a node is above the limit.",
  "widened-limit": "The file would take more memory than the limit.",
};

const COMPATIBILITY = {
  "version-unknown": "The file has a version that this reader does not know.",
  "transform-unknown": "The file has a value transform that this reader does not know.",
};

const IO = {
  unreadable: "The path cannot be opened or read, or is no regular file.",
  "foreign-file": "The file begins as no .hmk file does.",
};

const INSUFFICIENT = { truncated: "The file ends before the bytes it declares." };

export type Reason =
  | keyof typeof CORRUPTION | keyof typeof RESOURCE_LIMIT | keyof typeof COMPATIBILITY
  | keyof typeof IO | keyof typeof INSUFFICIENT;

function ofKind(kind: Kind, sentences: Record<string, string>): [string, { kind: Kind; sentence: string }][] {
  return Object.entries(sentences).map(([code, sentence]) => [code, { kind, sentence }]);
}

/** Kind and sentence of each reason code. */
export const REASONS: ReadonlyMap<string, { kind: Kind; sentence: string }> = new Map([
  ...ofKind("Io", IO), ...ofKind("InsufficientData", INSUFFICIENT), ...ofKind("Compatibility", COMPATIBILITY),
  ...ofKind("Corruption", CORRUPTION), ...ofKind("ResourceLimit", RESOURCE_LIMIT),
]);

/** A refusal: what programs compare is `kind` and `reason`, people read the message. */
export class HmkError extends Error {
  constructor(
    readonly kind: Kind, readonly reason: Reason, readonly where: string,
    found?: unknown, allowed?: unknown, readonly hint = "",
  ) {
    const parts = [found === undefined ? "" : `found ${String(found)}`,
      allowed === undefined ? "" : `allowed ${String(allowed)}`].filter((part) => part !== "");
    const detail = parts.length > 0 ? `${where}: ${parts.join(", ")}` : where;
    super(`${detail}${hint === "" ? "." : `. Next: ${hint}.`} [${kind}/${reason}]`);
    this.name = "HmkError";
  }

  /** What was violated, in one sentence. */
  get sentence(): string {
    return REASONS.get(this.reason)?.sentence ?? this.message;
  }
}

/** The error for a reason code, with the kind that belongs to it. */
export function fault(reason: Reason, where: string, found?: unknown, allowed?: unknown, hint = ""): HmkError {
  const kind = REASONS.get(reason)?.kind ?? "Corruption";
  return new HmkError(kind, reason, where, found, allowed, hint);
}
