"""The few data-sized kernels: native (Rust) where they are installed, or the readable NumPy reference.

The environment variable ``HMKCTA_BACKEND`` (``native`` or ``reference``) chooses; both compute the same up to rounding.
"""

from __future__ import annotations

import os
from warnings import warn

from ..errors import invalid
from . import reference


def _choose():  # the type is one of the two modules, which pyright infers and annotations cannot express
    wanted = os.environ.get("HMKCTA_BACKEND", "")
    if wanted not in ("", "native", "reference"):
        raise invalid("unknown-backend", "HMKCTA_BACKEND", repr(wanted), "native or reference")
    if wanted == "reference":
        return reference
    try:
        from . import native
    except ImportError as error:
        if wanted == "native":
            raise
        warn(
            f"The native kernels are missing ({error}); the NumPy reference takes their place, 10 to 100 times slower. "
            "Install hmkcta from a wheel or with a Rust compiler, or set HMKCTA_BACKEND=reference if this is meant.",
            stacklevel=2,
        )
        return reference
    return native


_backend = _choose()

name = _backend.name
fit_cells = _backend.fit_cells
accumulate = _backend.accumulate
project_cells = _backend.project_cells
dictionary_gram = _backend.dictionary_gram
set_threads = _backend.set_threads
