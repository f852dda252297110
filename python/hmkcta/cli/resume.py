"""What `compress` keeps of its work beside the output, and how to go on with it."""

from __future__ import annotations

import os
import shlex
from pathlib import Path
from typing import TYPE_CHECKING

import click

from ..errors import HmkctaError
from .options import WORDS

if TYPE_CHECKING:
    from ..journal import Journal

#: Key of `click.Context.meta` under which the journal of the command stands.
_JOURNAL = "hmkcta.journal"

resume_option = click.option("--resume", is_flag=True, help="Go on with interrupted work (kept in FILE.partial).")


def journal_beside(output: str, resume: bool, overwrite: bool) -> Journal:
    """The journal of what becomes `output`; how the command ends is told by it from now on."""
    from ..journal import Journal

    folder = Path(f"{os.fspath(output)}.partial")
    journal = Journal(folder, resume=resume, overwrite=overwrite and not resume)
    click.get_current_context().meta[_JOURNAL] = journal
    return journal


def abandon(ctx: click.Context) -> None:
    """Leave no journal behind in which nothing stands; for a process that ends without clean-up."""
    journal: Journal | None = ctx.meta.get(_JOURNAL)
    if journal is not None and not journal.holds_work:
        journal.close()


def nothing_kept(ctx: click.Context) -> str:
    """What to know of a command that leaves nothing to go on with."""
    if _JOURNAL not in ctx.meta:
        return "nothing is left half written"
    planned = any(str(word).partition("=")[0] == "--plan" for word in ctx.meta[WORDS])
    why = "no node was finished" if planned else "the choice of a plan is kept only once it is complete"
    return f"nothing is left half written, and nothing kept, as {why}. Next: the same command, which begins anew"


def going_on(ctx: click.Context, *, then: bool = False) -> str:
    """What is kept and the command that goes on with it, what is said before `then` being next; empty: nothing is."""
    journal: Journal | None = ctx.meta.get(_JOURNAL)
    try:
        if journal is None or not journal.holds_work:
            return ""
    except HmkctaError:  # the folder is out of reach: there is nothing to promise
        return ""
    words = ["hmkcta", "compress", *ctx.meta[WORDS]]
    command = shlex.join(words if "--resume" in words else [*words, "--resume"])
    return f"What is finished is kept in {journal.folder}{'; then' if then else '. Next'}: {command}"
