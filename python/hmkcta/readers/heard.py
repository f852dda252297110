"""What libraries print of what they cannot decode, before they go on without: heard here, and by nobody else."""

from __future__ import annotations

import logging
import os
import sys
from collections.abc import Callable, Generator
from contextlib import ExitStack, contextmanager, redirect_stdout
from io import StringIO
from tempfile import TemporaryFile

#: The logger of imagecodecs, whose words are printed only where nobody has set up logging.
_LOGGER = logging.getLogger("imagecodecs")


@contextmanager
def heard() -> Generator[Callable[[], str]]:
    """A function that gives what has been printed in the block.

    Libraries print by Python and by C, for which the process's own outputs are turned away meanwhile; or they log.

    >>> with heard() as said:
    ...     _ = os.write(2, b"IDAT: incorrect data check")
    ...     heard_of = said()
    >>> heard_of
    'IDAT: incorrect data check'
    """
    printed = StringIO()
    handler = logging.StreamHandler(printed)
    with TemporaryFile() as file, ExitStack() as back:
        for stream in (sys.stdout, sys.stderr):
            stream.flush()
        back.enter_context(redirect_stdout(printed))
        _LOGGER.addHandler(handler)
        back.callback(_LOGGER.removeHandler, handler)
        _LOGGER.propagate, propagated = False, _LOGGER.propagate
        back.callback(setattr, _LOGGER, "propagate", propagated)
        for number in (1, 2):
            kept = os.dup(number)
            back.callback(os.close, kept)
            back.callback(os.dup2, kept, number)
            os.dup2(file.fileno(), number)

        def said() -> str:
            return (printed.getvalue() + os.pread(file.fileno(), 4096, 0).decode("utf-8", "replace")).strip()

        yield said
