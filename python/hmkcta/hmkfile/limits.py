"""Limits on what a file may declare, checked before anything of that size is allocated (`docs/format.md`, part II).

Standard library only.
"""

from __future__ import annotations

from dataclasses import dataclass

from .reasons import fault


@dataclass(frozen=True)
class Limits:
    """The largest values that `open` takes of a file; what is beyond them is a `ResourceLimit` error.

    The comments beside the fields say what each bounds. For a file that is trusted pass larger ones:
    ``hmkcta.open(path, limits=Limits(rank=2048))``. `rank` and `level_cost` bound decomposed modes only: an
    undecomposed mode is indexed, not summed over, and its rank is bounded by its size.

    >>> Limits(rank=2048).rank, Limits().rank
    (2048, 1024)
    """

    order: int = 8  # modes of the tensor
    axes: int = 32  # axes of the source array
    elements: int = 2**48  # of the source array
    levels: int = 16  # and stages without numbers
    nodes: int = 1_000_000  # of all stages together
    clusters: int = 65_535  # C_n
    mixture: int = 8  # K_n
    rank: int = 1024  # R_n of a decomposed mode
    level_cost: int = 2**20  # prod K_n R_n over the decomposed modes, of any node
    widened: int = 64 * 2**20  # bytes of the arrays of all stages, beyond 64 a byte of the file
    json_bytes: int = 16 * 2**20  # the header
    json_depth: int = 16
    json_string: int = 4096  # characters of any string


DEFAULT_LIMITS = Limits()


def check_limit(reason: str, where: str, found: int, allowed: int) -> None:
    """Refuse a number above its limit.

    Raises:
        HmkctaError: `ResourceLimit`, of this reason.

    >>> check_limit("order-limit", "header.organisation", 4, 8)
    """
    if found > allowed:
        name = reason.removesuffix("-limit").replace("-", "_")
        raise fault(reason, where, found, f"at most {allowed}",
                    f"if you trust the file, hmkcta.open(path, limits=hmkcta.Limits({name}={found}))")
