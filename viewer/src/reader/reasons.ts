/** Every reason for which a file is refused: the codes and sentences of `docs/format.md`, section 8. */

export type Kind = "Compatibility" | "Corruption" | "InsufficientData" | "InvalidArgument" | "ResourceLimit" | "Io";

const CORRUPTION = {
  "header-bytes": "The header holds a control character or an upper-case digit in a \\u escape.",
  "json-encoding": "A JSON text is not UTF-8, or a string in it is half a surrogate pair.",
  "json-syntax": "A text is not JSON.",
  "json-duplicate-key": "An object names a key twice.",
  "json-number": "A number is NaN, infinite, or a whole number beyond 2^53 - 1.",
  "field-missing": "A required field is absent.",
  "field-unknown": "A field is not in this specification.",
  "field-type": "A field has the wrong JSON type.",
  "field-value": "A field has a value that is not allowed.",
  "metadata-hash": "The SHA-256 of the metadata text is not the one stored beside it.",
  organisation: "The modes do not list every axis exactly once.",
  "array-size": "The byte range of an array is not its shape times its item size.",
  "array-gap": "The byte ranges of the arrays leave a gap or overlap.",
  "array-alignment": "An array does not start at a multiple of its item size.",
  "array-order": "Core or basis numbers stand before a table, or before those of a lower level.",
  "code-range": "A code of a packed level has more than 12 bits of 0 before its 1.",
  "trailing-bytes": "Bytes follow the last array.",
  "array-missing": "An array that must be there is absent.",
  "array-unexpected": "An array is there that must not be.",
  "array-dtype": "An array has the wrong number type.",
  "array-shape": "An array has the wrong shape.",
  "array-crc": "The CRC-32 of an array's bytes is not the one stored in the metadata.",
  "node-shape": "C, K and R of a node are not all zero, or K <= C with all of them positive, as the mode allows.",
  "node-empty": "A node without rows in a mode has a shape that is not zero.",
  "level-bounds": "C, K and R of a level in the metadata are not the largest of its nodes.",
  "row-count": "A node does not own the rows that the mode sizes, or the parts of its parent, give it.",
  "offset-order": "Offsets do not start at 0 or do not ascend.",
  "offset-size": "The offsets give a node another number of values than its shape needs.",
  "offset-end": "The last offset is not the length of the array.",
  "child-order": "The children of the nodes are not none or PC each, numbered in order, covering the next level.",
  "cluster-range": "A row names a cluster subset that its node does not have.",
  "cluster-order": "The cluster subsets of a row are not distinct and ascending.",
  "part-range": "A row goes to a part that its node does not have.",
  "leaf-rows": "A row of a leaf has a part or local position that is not 0.",
  "local-range": "A row's position lies outside its child.",
  "local-twice": "Two rows have the same position in a child.",
  "self-child": "The only child of a node does not keep the order of the rows.",
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
  "levels-limit": "There are more levels than the limit.",
  "nodes-limit": "There are more nodes than the limit.",
  "clusters-limit": "C of a mode is above the limit.",
  "mixture-limit": "K of a mode is above the limit.",
  "rank-limit": "R of a mode is above the limit, or above the size of an undecomposed mode.",
  "level-cost-limit": "The product of K R over the decomposed modes of a level is above the limit.",
};

const COMPATIBILITY = {
  "not-hmk": "The file is a safetensors file without the metadata key hmkcta.",
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
