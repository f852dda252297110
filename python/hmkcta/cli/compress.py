"""`hmkcta compress`: array in, file out, and what it came to."""

from __future__ import annotations

import shlex
from dataclasses import asdict
from math import floor, isinf
from typing import Any

import click
from numpy.typing import NDArray

from ..axes import format_organisation
from ..backends import Device, find_device
from ..comparing.both_goals import UP_TO
from ..comparing.finer import USED
from ..encode import compress
from ..goals import misses
from ..hmkfile import check_output, level_sizes
from ..model import Model
from .failure import Exit
from .goal import Goal, beyond_cost, goal_from, goal_options, ordinary_cameras
from .notes import notes
from .options import (
    Command,
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
from .resume import journal_beside, resume_option

EXAMPLES = (
    "hmkcta compress wood.npy -o wood.hmk --axes light,view,y,x,rgb --snr 27",
    "hmkcta compress jet.raw -o jet.hmk --shape 64,64,64 --dtype float32 --size 500KB",
    'hmkcta compress jet.npy -o jet.hmk --plan "R=4,4,6,6 / R=2,2,3,3 C=4,3,4,4 K=2"',
)

#: SNR in dB from which about a level's numbers limit it, by their bits, and not its ranks; the same of packed ones;
#: the SNR in all from which float32 does, in which everything is decoded.
NUMBERS_SNR, PACKED_SNR, FLOAT32_SNR = {16: 60.0, 8: 40.0}, 60.0, 130.0


@click.command("compress", cls=Command, examples=EXAMPLES)
@click.argument("source", metavar="SRC", type=File())
@click.option("-o", "--output", required=True, type=OutputFile(), metavar="FILE", help="File to write.")
@goal_options
@together(device_option, resume_option, overwrite_option, json_option, quiet_option, verbose_option)
def compress_command(source: str, output: str, plan: str | None, device: str, resume: bool, overwrite: bool,
                     as_json: bool, quiet: bool, verbose: bool, **options: Any) -> None:
    """Compress the array SRC: .npy, HDF5, Zarr, NIfTI, NRRD, TIFF, pictures, raw.
    No goal: 1/100 of its bytes, or 50 dB. Exit code 7: FILE misses the goal.
    """
    goal = goal_from(options)
    check_output(output, overwrite)
    apart(source, output)
    where = find_device(device)
    if where.missing:
        click.echo(f"hmkcta: {where.fallback}", err=True)
    with (Progress(quiet or as_json) as progress, journal_beside(output, resume, overwrite) as journal,
          warnings_as_notes() as said):
        if resume and not journal.holds_work:
            click.echo(f"hmkcta: there is nothing in {journal.folder} to go on with: it begins anew.", err=True)
        array = goal.open(source, progress)
        model = compress(array, plan, snr=goal.snr, size=goal.size, kind=goal.kind, device=where,
                         progress=progress, journal=journal, **goal.settings_for(array))
        model.save(output, overwrite=overwrite)
    report: dict[str, Any] = {
        **describe(model, array, progress), "device": asdict(where), "nodes_resumed": journal.found,
        "plans_tried": progress.plans, **plan_of(model),
    }
    missed = missed_goal(model, goal)
    said += notes(model, array, planned=plan is not None) + unused(model, goal, plan)
    said += beyond_cost(model.decode_cost, goal, plan) + ordinary_cameras(goal, model.metadata.kind)
    if as_json:
        emit({"output": output, **report, "reached": missed is None, "notes": said})
    elif not quiet:
        click.echo(as_text(report))
        if where.name != "cpu":
            click.echo(on_device(where))
        click.echo(f"{output}: {model!r}")
        click.echo(f"plan: {shlex.join(['--organisation', report['organisation'], '--plan', report['plan']])}")
        if verbose:
            click.echo("\n".join(f"  {stage}: {seconds(time)}" for stage, time in progress.stages.items()), err=True)
    for sentence in [] if quiet else said:
        click.echo(f"hmkcta: {sentence}.", err=True)
    if missed is not None:
        better = advice(model, plan, goal)
        click.echo(f"hmkcta: {missed} {output} is written, and is the best found. Next: {better}.", err=True)
        click.get_current_context().exit(Exit.TARGET_MISSED)


def describe(model: Model, array: NDArray[Any], progress: Progress) -> dict[str, Any]:
    """What the model came to, level by level: `bytes` are a level's own, `bytes_upto` all that is read to decode it."""
    levels: list[dict[str, Any]] = []
    own = level_sizes(model.metadata, model.stages)
    read = model.nbytes - sum(own)
    for number, quality in enumerate(model.quality, start=1):
        upto, read = model.at_level(number), read + own[number - 1]
        spent = sum(time for stage, time in progress.stages.items() if stage.endswith(f"level {number}"))
        levels.append({
            "level": number, "snr_db": quality.snr_db, "transformed_snr_db": upto.metadata.transformed_snr_db[-1],
            "rmse": quality.rmse, "max_abs_error": quality.max_abs_error, "bytes": own[number - 1],
            "bytes_upto": read, "ratio": array.nbytes / read, "decode_cost": upto.decode_cost,
            "seconds": round(spent, 3),
        })
    return {"snr_db": model.snr, "bytes": model.nbytes, "ratio": array.nbytes / model.nbytes,
            "decode_cost": model.decode_cost, "seconds": round(progress.elapsed, 3), "levels": levels,
            "transform": model.metadata.transform["name"]}


def plan_of(model: Model) -> dict[str, str]:
    """The plan that made the model, as --organisation and --plan have it."""
    plan = model.made_by or model.plan
    return {"organisation": format_organisation(plan.organisation), "plan": str(plan)}


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
    fixed = plan is not None and "<=" not in plan
    if goal.size is None or model.nbytes >= USED * goal.size or isinf(model.snr) or fixed:
        return []
    cost, bound = goal.settings["decode_cost"], _is_bound_by_cost(model, goal)
    if model.snr > UP_TO:
        why = "everything is decoded in float32, which keeps hardly more. Next: as good is a smaller --size"
    elif plan is None and bound:
        why = (f"nothing better was found within --decode-cost {cost}. Next: allow more multiply-adds, if what reads "
               "the file may take longer for an element")
    elif plan is None:
        why = "nothing larger that was tried is better. Next: as good is a smaller --size"
    elif _keeps_no_more(model):
        numbers = "packed" if model.levels[-1].rice else f"{model.levels[-1].bits}-bit"
        why = f"the plan's {numbers} numbers keep no more. Next: add a level"
    elif bound:
        why = (f"the ranks of the plan allow no more within --decode-cost {cost}. Next: write higher ranks, and allow "
               "more multiply-adds")
    else:
        why = "the ranks of the plan allow no more. Next: write higher ones"
    return [f"of --size {100 * model.nbytes / goal.size:.0f} % are used: {why}"]


def _keeps_no_more(model: Model) -> bool:
    """Whether the numbers of all levels reach what their bits can."""
    return model.snr > sum(PACKED_SNR if level.rice else NUMBERS_SNR[level.bits] for level in model.levels)


def _is_bound_by_cost(model: Model, goal: Goal) -> bool:
    """Whether a rank more may be beyond --decode-cost."""
    return 2 * model.decode_cost > goal.settings["decode_cost"]


def advice(model: Model, plan: str | None, goal: Goal) -> str:
    """What may reach the goal that was missed."""
    levels = len(model.levels)
    if model.levels[-1].bits == 8 and (plan is not None or goal.settings["bits"] == 8):
        wide = "bits=16" if plan is not None and "bits=" in plan else "--bits 16"
        return f"allow numbers of two bytes, {wide}" + ("" if plan is None else ", or add ranks or a level")
    if model.snr > FLOAT32_SNR:
        return f"ask for up to {max(FLOAT32_SNR, floor(model.snr)):.0f} dB: everything is decoded in float32"
    if _keeps_no_more(model):
        return f'write a level more, for what float16 numbers leave: --plan "{" / ".join(["R=.."] * (levels + 1))}"'
    if plan is None:
        return "allow a higher --decode-cost, or try --quality thorough"
    bound = "<=" in plan and _is_bound_by_cost(model, goal)
    return "allow a higher --decode-cost, or add a level" if bound else "add ranks or a level"
