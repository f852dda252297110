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
    "organisation": "The modes do not list every axis exactly once.",
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
}

_RESOURCE_LIMIT = {
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
}

_COMPATIBILITY = {
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

#: Why a writer refuses a path, or a model that no file can hold; else it uses the reader's codes.
WRITER_REASONS: dict[str, Reason] = {
    "array-dtype": Reason(Kind.INVALID_ARGUMENT, "An array of the model has the wrong number type."),
    "array-shape": Reason(Kind.INVALID_ARGUMENT, "An array of the model has the wrong shape, or does not fit others."),
    "not-whole": Reason(Kind.INVALID_ARGUMENT, "Numbers of a stage are not whole ones of its step and its columns."),
    "output-exists": Reason(Kind.IO, "The output is there already."),
    "disk-full": Reason(Kind.IO, "The disk, the quota or the permitted file size is used up."),
    "unwritable": Reason(Kind.IO, "The output folder is missing or cannot be written to."),
}


def fault(reason: str, where: str, found: object = None, allowed: object = None, hint: str = "", *, told: str = ""
          ) -> HmkctaError:
    """The error for a reason code, with the kind that belongs to it.

    >>> fault("section-crc", "stages[0].runs[0]", "0x1", "0x2").kind
    <Kind.CORRUPTION: ('Corruption', 4)>
    """
    kind = (REASONS.get(reason) or WRITER_REASONS[reason]).kind
    return HmkctaError(kind, reason, where, found=found, allowed=allowed, hint=hint, told=told)
