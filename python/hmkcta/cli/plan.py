"""`hmkcta plan`: what `compress` would do, with its cost, without doing it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from math import prod
from time import perf_counter
from typing import Any

import click
import numpy as np

from ..axes import format_organisation, mode_sizes
from ..comparing.both_goals import are_compared
from ..encode import choose_plan
from ..filesize import predicted_bytes
from ..fitting.fit import EFFORTS
from ..forecast import Forecast, choosing_bytes, forecast
from ..plan import AUTO, Plan, multiply_adds
from ..plan_checks import check_plan
from ..streaming.budget import nodes_of
from ..streaming.scratch import scratch_folder
from ..streaming.source import Source
from ..streaming.source import described as describe_source
from ..support.executors import thread_count
from ..support.memory import format_bytes
from ..wanted import Wanted, read_plan
from .goal import Goal, beyond_cost, command_for, goal_from, goal_options, ordinary_cameras
from .options import Command, File, json_option, quiet_option, together, verbose_option
from .output import emit, seconds, share, table
from .progress import Progress

EXAMPLES = (
    "hmkcta plan wood.npy --axes light,view,y,x,rgb --snr 27",
    "hmkcta plan jet.raw --shape 64,64,64 --dtype float32 --size 500KB",
    'hmkcta plan jet.npy --plan "R=4,4,6,6 / R=2,2,3,3 C=4,3,4,4 K=2"',
)

#: SNR in dB that a level of float16 numbers does not surely reach.
ONE_LEVEL = 64.0


@click.command("plan", cls=Command, examples=EXAMPLES)
@click.argument("source", metavar="SRC", type=File())
@goal_options
@together(json_option, quiet_option, verbose_option)
def plan_command(source: str, plan: str | None, as_json: bool, quiet: bool, verbose: bool, **options: Any) -> None:
    """Show a plan for the array SRC and its cost, and the commands that follow it."""
    del verbose
    goal = goal_from(options)
    with Progress(quiet or as_json) as progress:
        watched = goal.open(source, progress)
        array = watched.array
        settings = goal.settings_for(array)
        described = describe_source(array, settings["axes"], settings["transform"])
        if plan is not None:
            chosen, choosing = given_plan(plan, described, goal), None
        else:
            begun = perf_counter()
            beside = {name: value for name, value in settings.items() if name != "scheme"}  # which is of written levels
            chosen = choose_plan(array, snr=goal.snr, size=goal.size, progress=progress, **beside)
            choosing = perf_counter() - begun  # `compress` does the same
            watched.check(None)
    report = describe(chosen, described, goal, choosing)
    report["command"] = command_for(source, "OUT.hmk", chosen, goal)
    report["goal_command"] = command_for(source, "OUT.hmk", None, goal) if plan is None else None
    report["seconds"] = round(progress.elapsed, 3)
    said = beyond_cost(report["decode_cost"], goal, plan) + ordinary_cameras(goal, described.kind)
    if as_json:
        emit({"source": source, **report, "notes": said})
    else:
        click.echo(as_text(report))
    for sentence in [] if quiet else said:
        click.echo(f"hmkcta: {sentence}.", err=True)


def given_plan(text: str, source: Source, goal: Goal) -> Plan:
    """The plan of --plan, as `compress` reads it."""
    beside = ("decode_cost", "organisation", "max_memory", "bits")
    wanted = Wanted(goal.snr, goal.size, **{name: goal.settings[name] for name in beside})
    plan = read_plan(text, source, wanted, goal.settings["scheme"])
    check_plan(plan, mode_sizes(source.axes, plan.organisation))
    return plan


def expected(plan: Plan, source: Source, goal: Goal, *, choosing: bool) -> Forecast:
    """What `compress` will take with the options given; its memory with that of `choosing` the plan, if it does."""
    options = goal.settings
    threads = thread_count(options["threads"])
    effort = EFFORTS[options["quality"]]
    held, memory = 0 if isinstance(source.array, np.memmap) else source.array.nbytes, options["max_memory"]
    before = choosing_bytes(prod(source.shape), effort, threads, memory, plan.snr) if choosing else 0
    sizes, most = mode_sizes(source.axes, plan.organisation), options["decode_cost"]
    return forecast(plan, sizes, effort, threads, memory, held=held, choosing=before, decode_cost=most,
                    stored=source.array.nbytes)


def describe(plan: Plan, source: Source, goal: Goal, choosing: float | None) -> dict[str, Any]:
    """What the plan does and costs; --decode-cost bounds the levels whose nodes choose their ranks.

    `choosing` are the seconds that finding the plan took, None if it was given.
    """
    sizes = mode_sizes(source.axes, plan.organisation)
    cost = expected(plan, source, goal, choosing=choosing is not None)
    costs = _decode_costs(plan, sizes, goal.settings["decode_cost"])
    # Plans for the other goal are chosen, too, which takes about as long.
    again = cost.comparing > 0 and goal.settings["quality"] != "fast" and are_compared(source)
    comparing = cost.comparing + (choosing or 0.0) * again
    return {
        "organisation": format_organisation(plan.organisation), "mode_sizes": list(sizes), "plan": str(plan),
        "levels": [{"level": number, "text": str(level), "search": level.search, "decode_cost": cost}
                   for number, (level, cost) in enumerate(zip(plan.levels, costs, strict=True), start=1)],
        "snr": plan.snr, "size": plan.size,
        "predicted_bytes": predicted_bytes(_largest(plan), source, goal.kind, goal.settings["seed"]),
        "expected_bytes": plan.expected,
        "decode_cost": sum(costs), "memory": cost.memory, "scratch": cost.scratch,
        "fitting_seconds": round(cost.seconds, 2), "comparing_seconds": round(comparing, 2),
        "choosing_seconds": None if choosing is None else round(choosing, 3), "source_bytes_float32": 4 * prod(sizes),
    }


def _decode_costs(plan: Plan, sizes: Sequence[int], allowed: int) -> list[int]:
    """Multiply-adds of every level, as far as nodes that are equal parts of those above have rows for its ranks."""
    costs = list[int]()
    for spec, _, _ in nodes_of(plan, sizes):
        cost = spec.decode_cost()
        costs.append(min(cost, max(1, allowed - sum(costs))) if spec.own else cost)
    return costs


def _largest(plan: Plan) -> Plan:
    """The plan with the scheme that takes most bytes, of those that `compress` may take."""
    return replace(plan, levels=tuple(replace(level, scheme="uniform") if level.scheme == AUTO and not level.grid
                                      else level for level in plan.levels))


def _doubt(report: dict[str, Any]) -> str:
    """What to say of a plan whose numbers round by more than its goal leaves."""
    beyond = report["snr"] is not None and report["snr"] > ONE_LEVEL and len(report["levels"]) == 1
    return f", whose one level may end at {ONE_LEVEL:g} dB" if beyond else ""


def _bytes(report: dict[str, Any]) -> str:
    """Bytes of the file, as far as they are known, and of how many they are one."""
    known = report["predicted_bytes"]
    count = known or report["expected_bytes"]
    if count is None:
        return f"as many as {report['snr']:g} dB need"
    of_all = f"{share(report['source_bytes_float32'] / count)} the values in float32"
    return f"{format_bytes(count)}, {of_all}" if known else f"about {format_bytes(count)}, {of_all}, as a sample tells"


def as_text(report: dict[str, Any]) -> str:
    """The plan for people."""
    modes = " x ".join(map(str, report["mode_sizes"]))
    rows = [[str(level["level"]), str(level["decode_cost"]), level["text"]] for level in report["levels"]]
    goals = [f"at least {report['snr']:g} dB"] if report["snr"] is not None else []
    goals += [f"at most {format_bytes(report['size'])}"] if report["size"] is not None else []
    times = [f"time          about {seconds(report['fitting_seconds'])} with the plan given, "
             "longer on a busy or slow machine"]
    if (choosing := report["choosing_seconds"]) is not None:
        others = report["comparing_seconds"]
        times += [f"              {seconds(choosing)} more to choose it anew"
                  + (f", and some {seconds(others)} to fit others that it is compared with" if others else "")]
    commands = ["To do it:", f"  {report['command']}"]
    if report["goal_command"] is not None:
        commands = ["To do it, and keep the best of this plan and others like it:", f"  {report['goal_command']}",
                    "This plan alone" + _doubt(report) + ":", f"  {report['command']}"]
    return "\n".join([
        f"organisation  {report['organisation']}  ({modes})",
        *([f"goal          {', '.join(goals)}"] if goals else []),
        f"bytes         {_bytes(report)}",
        f"decode cost   up to {multiply_adds(report['decode_cost'])} an element",
        f"memory        {format_bytes(report['memory'])}",
        *([f"scratch       {format_bytes(report['scratch'])} in {scratch_folder()}, set by TMPDIR"]
          if report["scratch"] else []),
        *times,
        "",
        table(["level", "decode cost", "ranks R, clusters C, mixture K"], rows, left=[2]),
        "",
        f"Found in {seconds(report['seconds'])}. {commands[0]}",
        *commands[1:],
    ])
