"""What `compress` keeps of its work beside the output, and how to go on with it."""

from __future__ import annotations

import os
import shlex
from pathlib import Path

import click

from ..errors import HmkctaError
from ..journal import Journal
from .options import WORDS

#: Key of `click.Context.meta` under which the journal of the command stands.
_JOURNAL = "hmkcta.journal"

resume_option = click.option("--resume", is_flag=True, help="Go on with interrupted work (kept in FILE.partial).")


def journal_beside(output: str, resume: bool, overwrite: bool) -> Journal:
    """The journal of what becomes `output`; how the command ends is told by it from now on."""
    folder = Path(f"{os.fspath(output)}.partial")
    journal = Journal(folder, resume=resume, overwrite=overwrite and not resume)
    click.get_current_context().meta[_JOURNAL] = journal
    return journal


def abandon(ctx: click.Context) -> None:
    """Leave no journal behind in which nothing stands; for a process that ends without clean-up."""
    journal = ctx.meta.get(_JOURNAL)
    if isinstance(journal, Journal) and not journal.holds_work:
        journal.close()


def going_on(ctx: click.Context) -> str:
    """What is kept and the command that goes on with it; empty where nothing is."""
    journal = ctx.meta.get(_JOURNAL)
    try:
        if not isinstance(journal, Journal) or not journal.holds_work:
            return ""
    except HmkctaError:  # the folder is out of reach: there is nothing to promise
        return ""
    words = ["hmkcta", "compress", *ctx.meta[WORDS]]
    command = shlex.join(words if "--resume" in words else [*words, "--resume"])
    return f"What is finished is kept in {journal.folder}. Next: {command}"
