"""Every reason for which a file is refused, with its kind: one list for reader, writer, documentation and corpus.

The codes are stable: programs and the TypeScript reader compare them. Standard library only.
"""

from __future__ import annotations

from typing import NamedTuple

from ..errors import HmkctaError, Kind


class Reason(NamedTuple):
    """Kind of a refusal, and a sentence on what was violated."""

    kind: Kind
    sentence: str


_CORRUPTION = {
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
    "organisation": "The modes do not list every axis exactly once.",
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
}

_RESOURCE_LIMIT = {
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
}

_COMPATIBILITY = {
    "not-hmk": "The file is a safetensors file without the metadata key hmkcta.",
    "version-unknown": "The file has a version that this reader does not know.",
    "transform-unknown": "The file has a value transform that this reader does not know.",
}

#: Why a reader refuses a file.
REASONS: dict[str, Reason] = {
    "unreadable": Reason(Kind.IO, "The path cannot be opened or read, or is no regular file."),
    "foreign-file": Reason(Kind.IO, "The file begins as no .hmk file does."),
    "truncated": Reason(Kind.INSUFFICIENT_DATA, "The file ends before the bytes it declares."),
    **{code: Reason(Kind.COMPATIBILITY, sentence) for code, sentence in _COMPATIBILITY.items()},
    **{code: Reason(Kind.CORRUPTION, sentence) for code, sentence in _CORRUPTION.items()},
    **{code: Reason(Kind.RESOURCE_LIMIT, sentence) for code, sentence in _RESOURCE_LIMIT.items()},
}

#: Why a writer refuses a path; for the model to be written it uses the reader's codes.
WRITER_REASONS: dict[str, Reason] = {
    "output-exists": Reason(Kind.IO, "The output is there already."),
    "disk-full": Reason(Kind.IO, "The disk, the quota or the permitted file size is used up."),
    "unwritable": Reason(Kind.IO, "The output folder is missing or cannot be written to."),
}


def fault(reason: str, where: str, found: object = None, allowed: object = None, hint: str = "", *, told: str = ""
          ) -> HmkctaError:
    """The error for a reason code, with the kind that belongs to it.

    >>> fault("array-crc", "level/1/core", "0x1", "0x2").kind
    <Kind.CORRUPTION: ('Corruption', 4)>
    """
    kind = (REASONS.get(reason) or WRITER_REASONS[reason]).kind
    return HmkctaError(kind, reason, where, found=found, allowed=allowed, hint=hint, told=told)
