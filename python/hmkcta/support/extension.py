"""The compiled part of the package, or a sentence on how to get it."""

from __future__ import annotations

from ..errors import invalid

try:
    from .. import _native as native
except ImportError as error:
    raise invalid("missing-native", "hmkcta._native", f"none that works ({error})", "the package's compiled kernels",
                  "install hmkcta from a wheel or with a Rust compiler") from error

__all__ = ["native"]
