"""`hmkcta compress`: array in, file out, and what it came to."""

from __future__ import annotations

import shlex
from contextlib import AbstractContextManager, nullcontext
from dataclasses import asdict
from math import floor, isinf
from typing import Any

import click
from numpy.typing import NDArray

from ..axes import format_organisation
from ..backends import Device, find_device
from ..encode import compress
from ..goals import misses
from ..hmkfile import check_output, level_sizes
from ..model import Model
from .failure import Exit
from .goal import Goal, beyond_cost, goal_from, goal_options, ordinary_cameras
from .interrupt import Patience, patient
from .layout import layout_lines, layout_of
from .notes import notes
from .options import (
    Command,
    Duration,
    File,
    OutputFile,
    apart,
    device_option,
    json_option,
    overwrite_option,
    quiet_option,
    together,
    verbose_option,
)
from .output import decibels, emit, mebibytes, ratio, seconds, table, transformed_column, warnings_as_notes
from .progress import Progress
from .resume import finished, journal_beside, publish, resume_option

EXAMPLES = (
    "hmkcta compress wood.npy -o wood.hmk --axes light,view,y,x,rgb --snr 27",
    "hmkcta compress jet.raw -o jet.hmk --shape 64,64,64 --dtype float32 --size 500KB",
    'hmkcta compress jet.npy -o jet.hmk --plan "R=4,4,6,6 / R=2,2,3,3 C=4,3,4,4 K=2"',
)

#: SNR in dB that one level hardly exceeds, as its numbers are float16 in the file or once it is opened: cores and bases
#: together end at some 65 dB, values that are stored as they are at 74.
LEVEL_SNR = 65.0
#: SNR in dB from which about float32 limits what is kept, in which everything is decoded.
FLOAT32_SNR = 130.0
#: A size of which at least this share is used is used.
USED = 0.99


@click.command("compress", cls=Command, examples=EXAMPLES)
@click.argument("source", metavar="SRC", type=File())
@click.option("-o", "--output", required=True, type=OutputFile(), metavar="FILE", help="File to write.")
@goal_options
@click.option("--time", type=Duration(), metavar="TIME",
              help="Search about as long at most: 90s, 5min.")
@together(device_option, resume_option, overwrite_option, json_option, quiet_option, verbose_option)
def compress_command(source: str, output: str, plan: str | None, device: str, resume: bool, overwrite: bool,
                     as_json: bool, quiet: bool, verbose: bool, **options: Any) -> None:
    """Compress the array SRC: .npy, HDF5, Zarr, NIfTI, VTK, TIFF, pictures, raw, ..
    No goal: 1/100 of its bytes, or 50 dB. Exit code 7: FILE misses the goal.
    """
    goal = goal_from(options)
    if resume and (before := finished(output)) is not None:
        _say_finished(output, *before, as_json, quiet)
        return
    check_output(output, overwrite)
    apart(source, output)
    where = find_device(device)
    if where.missing:
        click.echo(f"hmkcta: {where.fallback}", err=True)
    with (Progress(quiet or as_json) as progress, journal_beside(output, resume, overwrite) as journal,
          warnings_as_notes() as said, _finishing_early(progress, plan) as patience):
        if resume and not journal.holds_work:
            click.echo(f"hmkcta: there is nothing in {journal.folder} to go on with: it begins anew.", err=True)
        watched = goal.open(source, progress)
        array = watched.array
        model = compress(array, plan, snr=goal.snr, size=goal.size, kind=goal.kind, device=where,
                         progress=progress, journal=journal, enough=patience and (lambda: patience.asked),
                         **goal.settings_for(array))
        watched.check(model.metadata.source["sha256"])
        missed = _missed(model, goal, plan, output)
        publish(journal, model, output, overwrite, missed)
    report: dict[str, Any] = {
        **describe(model, array, progress), "device": asdict(where), "nodes_resumed": journal.found,
        **plan_of(model),
    }
    said += [f"{source} is no longer there: {output} is of what it was"] if watched.gone else []
    said += notes(model, array, planned=plan is not None) + unused(model, goal, plan)
    said += ["the search was ended early"] if patience is not None and patience.asked else []
    said += beyond_cost(model.decode_cost, goal, plan) + ordinary_cameras(goal, model.metadata.kind)
    if as_json:
        emit({"output": output, **report, "reached": missed is None, "notes": said})
    elif not quiet:
        click.echo(as_text(report))
        if where.name != "cpu":
            click.echo(on_device(where))
        click.echo(f"{output}: {model!r}")
        click.echo("\n".join(_made_by(model, report)))
        if verbose:
            click.echo("\n".join(f"  {stage}: {seconds(time)}" for stage, time in progress.stages.items()), err=True)
    for sentence in [] if quiet else said:
        click.echo(f"hmkcta: {sentence}.", err=True)
    _end(missed)


def _finishing_early(progress: Progress, plan: str | None) -> AbstractContextManager[Patience | None]:
    """The first Ctrl-C of a search, once it has begun, is a wish to take the best found so far."""
    said = "hmkcta: taking the best that was found so far; once more ends at once."
    if plan is not None:
        return nullcontext()
    return patient(lambda: click.echo(said, err=True), lambda: "search" in progress.stages)


def _missed(model: Model, goal: Goal, plan: str | None, output: str) -> str | None:
    """What is said where a goal was not reached."""
    missed = missed_goal(model, goal)
    better = "" if missed is None else f"{output} is written, and is the best found. Next: {advice(model, plan)}."
    return None if missed is None else f"{missed} {better}"


def _say_finished(output: str, model: Model, missed: str | None, as_json: bool, quiet: bool) -> None:
    """What is left to say where the interrupted command had written its file."""
    said = "it was finished already, and only its journal was left"
    if as_json:
        emit({"output": output, "snr_db": model.snr, "bytes": model.nbytes, "decode_cost": model.decode_cost,
              "reached": missed is None, "notes": [said]})
    elif not quiet:
        click.echo(f"{output}: {model!r}")
    if not quiet:
        click.echo(f"hmkcta: {said}.", err=True)
    _end(missed)


def _end(missed: str | None) -> None:
    """End the command with the exit code of a goal that was missed, if one was."""
    if missed is not None:
        click.echo(f"hmkcta: {missed}", err=True)
        click.get_current_context().exit(Exit.TARGET_MISSED)


def describe(model: Model, array: NDArray[Any], progress: Progress) -> dict[str, Any]:
    """What the model came to, level by level: `bytes` are a level's own, `bytes_upto` all that is read to decode it."""
    levels: list[dict[str, Any]] = []
    own = level_sizes(model.metadata, model.stages)
    read = model.nbytes - sum(own)
    for number, quality in enumerate(model.quality, start=1):
        upto, read = model.at_level(number), read + own[number - 1]
        spent = progress.elapsed if len(own) == 1 else sum(
            time for stage, time in progress.stages.items() if stage.endswith(f"level {number}"))
        levels.append({
            "level": number, "snr_db": quality.snr_db, "transformed_snr_db": upto.metadata.transformed_snr_db[-1],
            "rmse": quality.rmse, "max_abs_error": quality.max_abs_error, "bytes": own[number - 1],
            "bytes_upto": read, "ratio": array.nbytes / read, "decode_cost": upto.decode_cost,
            "seconds": round(spent, 3),
        })
    return {"snr_db": model.snr, "bytes": model.nbytes, "ratio": array.nbytes / model.nbytes,
            "decode_cost": model.decode_cost, "seconds": round(progress.elapsed, 3), "levels": levels,
            "transform": model.metadata.transform["name"]}


def plan_of(model: Model) -> dict[str, Any]:
    """The organisation, the text of a written plan (None where a goal chose), and how the array is cut."""
    plan = model.made_by
    organisation = format_organisation(model.metadata.organisation)
    return {"organisation": organisation, "plan": None if plan is None else str(plan), "layout": layout_of(model)}


def _made_by(model: Model, report: dict[str, Any]) -> list[str]:
    """The words that fit the same plan again; of a model that a goal chose, which none does, what it is."""
    if report["plan"] is not None:
        searches = [] if model.made_by is None else [
            f"level {number}: {level.search_said}" for number, level in enumerate(model.made_by.levels, start=1)]
        return [f"plan: {shlex.join(['--organisation', report['organisation'], '--plan', report['plan']])}", *searches]
    return [f"organisation: {report['organisation']}", *(f"layout: {line}" for line in layout_lines(model))]


def as_text(report: dict[str, Any]) -> str:
    """The table, and the time that belongs to no level."""
    levels = report["levels"]
    domain, inner = transformed_column(report["transform"], levels)
    rows = [[str(level["level"]), decibels(level["snr_db"]), *of_transformed, mebibytes(level["bytes_upto"]),
             ratio(level["ratio"]), str(level["decode_cost"]), f"{level['seconds']:.1f}"]
            for level, of_transformed in zip(levels, inner, strict=True)]
    header = ["level", "SNR dB", *domain, "MiB", "ratio", "decode cost", "seconds"]
    whole = table(header, rows)
    before = report["nodes_resumed"]
    resumed = f" {before} node{' was' if before == 1 else 's were'} finished before." if before else ""
    return f"{whole}\nAll of it took {seconds(report['seconds'])}.{resumed}"


def on_device(device: Device) -> str:
    """What the GPU did."""
    calls = device.calls + device.calls_on_cpu
    return f"{device.described}: {device.calls} of {calls} kernel calls; smaller ones are faster on the CPU."


def missed_goal(model: Model, goal: Goal) -> str | None:
    """A sentence on the goal that was not reached; None if all were."""
    if misses(model.snr, goal.snr):
        return f"the SNR is {model.snr:.2f} dB, below --snr {goal.snr:g}."
    if goal.size is not None and model.nbytes > goal.size:
        return f"the file has {model.nbytes} bytes, more than --size {goal.size}."
    return None


def unused(model: Model, goal: Goal, plan: str | None) -> list[str]:
    """A sentence on what keeps a file from its --size; none if it has it, or nothing is left to store."""
    if goal.size is None or plan is not None or model.nbytes >= USED * goal.size or isinf(model.snr):
        return []
    why = ("numbers are decoded in float16, which keeps hardly more" if model.snr > LEVEL_SNR else
           "that is the closest to it that was found")
    return [f"of --size {100 * model.nbytes / goal.size:.0f} % are used: {why}. Next: as good is a smaller --size"]


def advice(model: Model, plan: str | None) -> str:
    """What may reach the goal that was missed."""
    levels = len(model.levels)
    if model.snr > FLOAT32_SNR:
        return f"ask for up to {floor(model.snr)} dB: everything is decoded in float32"
    if plan is None and model.snr > LEVEL_SNR:
        return f"ask for up to {floor(model.snr)} dB: a search makes two levels of float16 numbers at most"
    if model.snr > LEVEL_SNR * levels:
        text = " / ".join(["R=.."] * (levels + 1))
        return (f"ask for up to {floor(model.snr)} dB, or write a level more, for what float16 numbers leave: "
                f'--plan "{text}"')
    if plan is None:
        return "allow a higher --decode-cost, or try --quality thorough"
    return "add ranks or a level"
