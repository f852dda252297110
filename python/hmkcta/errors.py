"""One exception, sorted by a fixed kind and a stable reason code.

Programs compare `kind` and `reason`; people read the sentence, which names the field, the value found,
what is allowed and what to do next. The TypeScript reader uses the same codes.
"""

from __future__ import annotations

import errno
from enum import Enum
from typing import Any

#: Letters of a value that is shown.
SHOWN = 80
#: The length to which the sentence of a library is cut.
SENTENCE = 200
#: What the system says where a disk, or a quota of it, is full.
DISK_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)


class Kind(Enum):
    """What went wrong, with the exit code the command line ends with.

    Attributes:
        label: the kind as messages and the TypeScript reader have it, e.g. ``"InvalidArgument"``.
        exit_code: 2 for an invalid argument, 3 to 6, 8 and 9 for the others.

    >>> Kind.CORRUPTION.label, Kind.CORRUPTION.exit_code
    ('Corruption', 4)
    """

    INVALID_ARGUMENT = ("InvalidArgument", 2)
    IO = ("Io", 3)
    CORRUPTION = ("Corruption", 4)
    INSUFFICIENT_DATA = ("InsufficientData", 4)
    COMPATIBILITY = ("Compatibility", 5)
    RESOURCE_LIMIT = ("ResourceLimit", 6)
    SOURCE_CHANGED = ("SourceChanged", 8)
    OTHER_SOURCE = ("OtherSource", 9)

    def __init__(self, label: str, exit_code: int) -> None:
        self.label = label
        self.exit_code = exit_code


class GoalMissed(UserWarning):
    """The SNR that was asked for is out of reach: the model is the best found.

    `compress` warns with it and returns that model; on the command line it is exit code 7. A filter of Python's makes
    it an exception:

    >>> import warnings
    >>> from hmkcta import compress
    >>> with warnings.catch_warnings():
    ...     warnings.simplefilter("error", GoalMissed)
    ...     compress([[2, 0], [0, 1]], "R=1", snr=30)
    Traceback (most recent call last):
        ...
    hmkcta.errors.GoalMissed: the SNR is 6.99 dB, below the 30 dB asked for; the model is the best found
    """


class HmkctaError(Exception):
    """Any failure that hmkcta foresees.

    Attributes:
        kind: one of `Kind`.
        reason: stable reason code in kebab case, e.g. ``"rank-too-large"``.
        where: the argument, array or JSON path at fault, e.g. ``"level/2/core"``.
        found: the value found there, or None.
        allowed: what is allowed instead, in words, or None.
        hint: what to do next, or empty.

    Args:
        told: what the sentence says in place of "found .., allowed ..", where that would read oddly.

    >>> error = HmkctaError(Kind.INVALID_ARGUMENT, "rank-too-large", "R of mode 2",
    ...                     found="9", allowed="1 to 8", hint="lower R or write R=*")
    >>> print(error)
    R of mode 2: found 9, allowed 1 to 8. Next: lower R or write R=*. [InvalidArgument/rank-too-large]
    """

    def __init__(self, kind: Kind, reason: str, where: str, *, found: object = None, allowed: object = None,
                 hint: str = "", told: str = "") -> None:
        self.kind = kind
        self.reason = reason
        self.where = where
        self.found = found
        self.allowed = allowed
        self.hint = hint
        parts = [] if found is None else [f"found {found}"]
        parts += [] if allowed is None else [f"allowed {allowed}"]
        said = told or ", ".join(parts)
        sentence = f"{where}: {said}" if said else where
        advice = f". Next: {hint}." if hint else "."
        super().__init__(f"{sentence}{advice} [{kind.label}/{reason}]")

    def __reduce__(self) -> tuple[Any, ...]:
        """For `pickle`, by which processes hand errors to one another: it is made of its sentence, then its fields."""
        return _made_again, (type(self), str(self)), dict(vars(self))


class ForeignFile(HmkctaError):
    """No `.hmk` file, by how it begins.

    The command line ends with 3, as it does for a file that cannot be read.

    >>> issubclass(ForeignFile, HmkctaError)
    True
    """


def _made_again(error: type[HmkctaError], sentence: str) -> HmkctaError:
    return error.__new__(error, sentence)


def invalid(reason: str, where: str, found: object = None, allowed: object = None, hint: str = "") -> HmkctaError:
    """An `InvalidArgument` error, to be raised: what the caller asked for cannot be.

    >>> print(invalid("clusters-too-small", "C of mode 1", 0, "1 or more"))
    C of mode 1: found 0, allowed 1 or more. [InvalidArgument/clusters-too-small]
    """
    return HmkctaError(Kind.INVALID_ARGUMENT, reason, where, found=found, allowed=allowed, hint=hint)


def source_changed(reason: str, where: str, told: str) -> HmkctaError:
    """The error, to be raised, where a source did not stay as it was while it was read.

    >>> print(source_changed("source-changed", "wood.npy", "has changed while it was read"))
    wood.npy: has changed while it was read. Next: wait until nobody writes it, and begin anew. \
[SourceChanged/source-changed]
    """
    hint = "wait until nobody writes it, and begin anew"
    return HmkctaError(Kind.SOURCE_CHANGED, reason, where, hint=hint, told=told)


def expect(name: str, value: object, types: Any, words: str, hint: str = "") -> None:
    """Refuse an argument of another type by its name, before something deep inside stumbles over it.

    Raises:
        HmkctaError: reason ``argument-type``; also for a bool where numbers are asked for.

    >>> expect("level", "1", int, "a whole number")
    Traceback (most recent call last):
        ...
    hmkcta.errors.HmkctaError: level: found '1', allowed a whole number. [InvalidArgument/argument-type]
    """
    truth = isinstance(value, bool) and types is not bool  # which Python counts among whole numbers
    if truth or not isinstance(value, types):
        raise invalid("argument-type", name, shown(value), words, hint)


def shown(value: object) -> str:
    """A value of whatever type and length as a sentence has it.

    >>> shown([1] * 100)[-10:]
    ', 1, 1, ..'
    """
    text = " ".join(repr(value).split())
    return text if len(text) <= SHOWN else f"{text[: SHOWN - 3].rsplit(maxsplit=1)[0]} .."


def sentence(error: BaseException) -> str:
    """The first line of what an exception says, or its name.

    >>> sentence(KeyError()), sentence(ValueError("no such chunk.\\nMore"))
    ('KeyError', 'no such chunk')
    """
    lines = str(error).strip().splitlines()
    return lines[0][:SENTENCE].rstrip(" .:") if lines else type(error).__name__
