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
    from ..model import Model

#: Key of `click.Context.meta` under which the journal of the command stands.
_JOURNAL = "hmkcta.journal"
#: Words of a command that change nothing of what it makes.
_PASSING = ("--resume", "--overwrite", "--json", "--quiet", "-v", "--verbose")

resume_option = click.option("--resume", is_flag=True, help="Go on with interrupted work (kept in FILE.partial).")


def journal_beside(output: str, resume: bool, overwrite: bool) -> Journal:
    """The journal of what becomes `output`; how the command ends is told by it from now on."""
    from ..journal import Journal

    folder = Path(f"{os.fspath(output)}.partial")
    journal = Journal(folder, resume=resume, overwrite=overwrite and not resume)
    click.get_current_context().meta[_JOURNAL] = journal
    return journal


def publish(journal: Journal, model: Model, output: str, overwrite: bool, missed: str | None) -> None:
    """Save the model, so that a process killed before `journal` is removed is known to have finished."""
    from ..hmkfile import file_digest

    digest = file_digest(model.metadata, model.stages)
    journal.about_to_publish({"file": digest, "words": _lasting_words(), "missed": missed})
    model.save(output, overwrite=overwrite)


def finished(output: str) -> tuple[Model, str | None] | None:
    """The model that an interrupted run of the same command wrote already, and how it missed its goal.

    What the run had kept, and what killed writers left beside the output, is removed.
    """
    from ..hmkfile import file_digest, remove_stale
    from ..journal import Journal
    from ..model import open as open_model

    journal = Journal(Path(f"{os.fspath(output)}.partial"), resume=True)
    done = journal.done
    if done.get("words") != _lasting_words():
        return None
    try:
        model = open_model(output)
    except HmkctaError:  # it is not there, or not this run's
        return None
    if file_digest(model.metadata, model.stages) != done.get("file"):
        return None
    journal.remove()
    remove_stale(output)
    return model, done.get("missed")


def _lasting_words() -> list[str]:
    """The words of the command but for those that say how it begins and what it shows."""
    return [word for word in map(str, click.get_current_context().meta[WORDS]) if word not in _PASSING]


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
    why = "no node was finished" if planned else "the search keeps only what it has settled"
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
