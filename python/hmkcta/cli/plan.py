"""`hmkcta plan`: what `compress` would make, without making it: by samples for a goal, counted for a written plan."""

from __future__ import annotations

from math import prod
from typing import Any

import click

from ..axes import Organisation, format_organisation, mode_sizes
from ..encode import estimate
from ..plan import Plan, multiply_adds
from ..plan_checks import check_plan
from ..planned_size import header_bytes, level_sizes_of
from ..search.find import Estimate
from ..streaming.budget import memory_limit, room_beside, with_searches
from ..streaming.source import Source
from ..streaming.source import described as describe_source
from ..support.memory import format_bytes
from ..wanted import read_plan, wanted_of
from .goal import Goal, beyond_cost, command_for, goal_from, goal_options, ordinary_cameras
from .layout import blocks_text
from .options import Command, File, json_option, quiet_option, together, verbose_option
from .output import decibels, emit, seconds, share, table
from .progress import Progress

EXAMPLES = (
    "hmkcta plan wood.npy --axes light,view,y,x,rgb --snr 27",
    "hmkcta plan jet.raw --shape 64,64,64 --dtype float32 --size 500KB",
    'hmkcta plan jet.npy --plan "R=4,4,6,6 / R=2,2,3,3 C=4,3,4,4 K=2"',
)


@click.command("plan", cls=Command, examples=EXAMPLES)
@click.argument("source", metavar="SRC", type=File())
@goal_options
@together(json_option, quiet_option, verbose_option)
def plan_command(source: str, plan: str | None, as_json: bool, quiet: bool, verbose: bool, **options: Any) -> None:
    """Show what a goal or a --plan makes of the array SRC, and the command that does it.
    What a goal makes is an estimate by samples; the numbers of a --plan are counted.
    """
    del verbose
    goal = goal_from(options)
    with Progress(quiet or as_json) as progress:
        watched = goal.open(source, progress)
        array = watched.array
        settings = goal.settings_for(array)
        described = describe_source(array, settings["axes"], settings["transform"])
        if plan is None:
            beside = {name: value for name, value in settings.items() if name not in ("scheme", "search")}
            found = estimate(array, snr=goal.snr, size=goal.size, progress=progress, **beside)
            watched.check(None)
            report, text = estimated(found, described, goal), estimate_as_text
            command = command_for(source, "OUT.hmk", None, goal)
        else:
            given = given_plan(plan, described, goal)
            report, text = counted(given, described), plan_as_text
            command = command_for(source, "OUT.hmk", given, goal)
    report: dict[str, Any] = {**report, "command": command, "seconds": round(progress.elapsed, 3)}
    said = ordinary_cameras(goal, described.kind)
    said += [] if plan is None else beyond_cost(report["decode_cost"], goal, plan)
    if as_json:
        emit({"source": source, **report, "notes": said})
    else:
        click.echo(text(report))
    for sentence in [] if quiet else said:
        click.echo(f"hmkcta: {sentence}.", err=True)


def given_plan(text: str, source: Source, goal: Goal) -> Plan:
    """The plan of --plan, as `compress` reads and refuses it."""
    settings = goal.settings
    wanted = wanted_of(goal.snr, goal.size, settings["decode_cost"], settings["organisation"], settings["max_memory"])
    plan = read_plan(text, source, wanted, settings["scheme"], settings["search"])
    sizes = mode_sizes(source.axes, plan.organisation)
    check_plan(plan, sizes)
    plan = with_searches(plan, sizes, room_beside(prod(sizes), settings["max_memory"]), settings["max_memory"])
    memory_limit(plan, sizes, settings["max_memory"])
    return plan


def _shared(source: Source, organisation: Organisation, snr: float | None, size: int | None) -> dict[str, Any]:
    """What is reported of a goal and of a written plan."""
    sizes = mode_sizes(source.axes, organisation)
    return {"organisation": format_organisation(organisation), "mode_sizes": list(sizes), "snr": snr, "size": size,
            "source_bytes_float32": 4 * prod(sizes)}


def estimated(found: Estimate, source: Source, goal: Goal) -> dict[str, Any]:
    """What is estimated of the file for a goal."""
    names = [format_organisation((mode,)) for mode in found.organisation]
    return {
        **_shared(source, found.organisation, goal.snr, goal.size), "plan": None,
        "blocks": {axis.name: count for axis, count in zip(source.axes, found.blocks, strict=True)},
        "undecomposed": [[names[n] for n in modes] for modes in found.undecomposed],
        "estimated_bytes": found.nbytes, "estimated_snr_db": found.snr, "estimated_seconds": round(found.seconds, 2),
    }


def counted(plan: Plan, source: Source) -> dict[str, Any]:
    """What is counted of the file of a written plan, and estimated of its tables.

    Bytes and decode costs are the most there can be: an SNR may be reached by fewer levels.
    """
    sizes = level_sizes_of(plan, source.axes)
    levels = [{"level": number, "text": str(level), "search": level.search,
               "search_said": level.search_said, "nodes": size.nodes,
               "numbers": size.numbers, "number_bytes": size.number_bytes, "numbers_are_exact": size.exact,
               "estimated_table_bytes": size.table_bytes, "decode_cost": size.decode_cost}
              for number, (level, size) in enumerate(zip(plan.levels, sizes, strict=True), start=1)]
    numbers = sum(size.number_bytes for size in sizes)
    tables = sum(size.table_bytes for size in sizes) + header_bytes(plan, source.axes)
    return {
        **_shared(source, plan.organisation, plan.snr, plan.size), "plan": str(plan), "levels": levels,
        "number_bytes": numbers, "numbers_are_exact": all(size.exact for size in sizes),
        "estimated_table_bytes": tables, "estimated_bytes": numbers + tables,
        "decode_cost": sum(size.decode_cost for size in sizes),
    }


def _heading(report: dict[str, Any]) -> list[str]:
    modes = " x ".join(map(str, report["mode_sizes"]))
    goals = [f"at least {report['snr']:g} dB"] if report["snr"] is not None else []
    goals += [f"at most {format_bytes(report['size'])}"] if report["size"] is not None else []
    return [f"organisation  {report['organisation']}  ({modes})", *([f"goal          {goals[0]}"] if goals else [])]


def _of_all(report: dict[str, Any]) -> str:
    return f"{share(report['source_bytes_float32'] / report['estimated_bytes'])} the values in float32"


def estimate_as_text(report: dict[str, Any]) -> str:
    """An estimate for people."""
    sets = [" and ".join(names) or "no mode" for names in report["undecomposed"]]
    return "\n".join([
        "Estimated by samples; compress decides between the best few on all of the array.",
        *_heading(report),
        f"blocks        {blocks_text(list(report['blocks'].values()), list(report['blocks']))}",
        f"undecomposed  {', '.join(sets) if sets else 'no mode'}",
        f"bytes         about {format_bytes(report['estimated_bytes'])}, {_of_all(report)}",
        f"SNR           about {decibels(report['estimated_snr_db'])} dB",
        f"time          about {seconds(report['estimated_seconds'])}, longer on a busy machine",
        "",
        f"Estimated in {seconds(report['seconds'])}. To do it:",
        f"  {report['command']}",
    ])


def plan_as_text(report: dict[str, Any]) -> str:
    """A written plan for people."""
    exactly = "exactly" if report["numbers_are_exact"] else "at most"
    rows = [[str(level["level"]), str(level["nodes"]),
             ("" if level["numbers_are_exact"] else "<= ") + str(level["numbers"]),
             str(level["decode_cost"]), level["text"]] for level in report["levels"]]
    return "\n".join([
        *_heading(report),
        f"numbers       {exactly} {format_bytes(report['number_bytes'])} in float16, less where nothing is left to fit",
        f"tables        about {format_bytes(report['estimated_table_bytes'])}, with the header",
        f"bytes         about {format_bytes(report['estimated_bytes'])}, {_of_all(report)}",
        f"decode cost   up to {multiply_adds(report['decode_cost'])} an element",
        "",
        table(["level", "nodes", "numbers", "decode cost", "ranks R, clusters C, mixture K"], rows, left=[4]),
        "",
        *(f"level {level['level']}: {level['search_said']}" for level in report["levels"]),
        "",
        "To do it:",
        f"  {report['command']}",
    ])
