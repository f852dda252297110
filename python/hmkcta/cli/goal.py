"""Options that say what to fit: a goal, or a plan, and how the array is to be understood. For `compress` and `plan`."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, cast

import click
from numpy.typing import NDArray

from ..axes import check_kind, format_organisation
from ..errors import invalid
from ..fitting.fit import EFFORTS
from ..hmkfile import KINDS
from ..labels import labels_of
from ..plan import AUTO, SCHEMES, SEARCHES, Plan, multiply_adds
from ..readers import WatchedSource, read_coordinates
from .options import SOURCE, Assignment, ByteSize, Count, Names, memory_option, nan_option, source_options, together
from .progress import Progress

goal_options = together(
    click.option("--snr", type=float, metavar="DB", help="Goal: at least this SNR, in as few bytes as found."),
    click.option("--size", type=ByteSize(), metavar="SIZE",
                 help="Goal: the highest SNR in this file size, e.g. 20MiB."),
    click.option("--decode-cost", type=Count(1), default=4096, metavar="N",
                 help="Of a goal: most multiply-adds an element (default 4096)."),
    click.option("--quality", type=click.Choice(list(EFFORTS)), default="medium", metavar="NAME",
                 help="Effort: fast, medium or thorough (default medium)."),
    click.option("--plan", "plan", metavar="TEXT", help="Levels to fit: R=.. C=.. K=.. / R=.. C=.. K=.."),
    click.option("--organisation", metavar="TEXT", help='Axes into modes: "light+rgb, view, y+x".'),
    click.option("--scheme", type=click.Choice([AUTO, *SCHEMES]), default=AUTO, metavar="NAME",
                 help="Subdivision: auto, most, least, uniform (default auto)."),
    click.option("--search", type=click.Choice([AUTO, *SEARCHES]), default=AUTO, metavar="NAME",
                 help="Clusters of rows: auto, optimal, greedy, fast (default auto)."),
    click.option("--axes", type=Names(), metavar="A,B,..", help="Names of the axes: light,view,y,x,rgb, NAME:ROLE."),
    click.option("--coords", type=Assignment(), multiple=True, metavar="AXIS=FILE",
                 help="Directions, positions: .npy, .npz, .csv or .txt."),
    click.option("--unit", type=Assignment(), multiple=True, metavar="AXIS=UNIT",
                 help="Unit of an axis's coordinates: degrees, nm, .."),
    click.option("--kind", type=click.Choice(KINDS), metavar="NAME",
                 help="Kind of data: svbrdf, lightfield, volume or generic."),
    click.option("--transform", default="identity", metavar="NAME",
                 help="Transform values first: log1p[:S], asinh[:S] or sqrt."),
    nan_option,
    click.option("--seed", type=Count(0), default=0, metavar="N",
                 help="Seed; the same one makes the same file (default 0)."),
    click.option("--threads", type=Count(1), metavar="N", help="Threads, no more than there are cores (default: all)."),
    memory_option,
    source_options,
)


@dataclass(frozen=True)
class Goal:
    """What the options of `goal_options` say."""

    snr: float | None
    size: int | None
    kind: str | None
    settings: dict[str, Any]  # further arguments of `compress`; axes by name
    source: dict[str, Any]  # arguments of `open_array`
    along: dict[str, tuple[tuple[str, str], ...]]  # --coords and --unit

    def open(self, path: str, progress: Progress) -> WatchedSource:
        """The source."""
        return WatchedSource(path, **self.source, max_memory=self.settings["max_memory"], progress=progress)

    def settings_for(self, array: NDArray[Any]) -> dict[str, Any]:
        """The settings, with the coordinates and units of the axes of the source.

        Raises:
            HmkctaError: an axis that is not there, coordinates that cannot be read, axes that do not make the --kind.
        """
        if self.kind is not None:
            check_kind(labels_of(array).named(array.shape, self.settings["axes"]), self.kind)
        if not any(self.along.values()):
            return self.settings
        axes = {axis.name: axis for axis in labels_of(array).named(array.shape, self.settings["axes"])}
        for option, given in self.along.items():
            for name, value in given:
                if name not in axes:
                    raise invalid("axis-unknown", f"--{option}", repr(name), ", ".join(axes), "name axes by --axes")
                change = {"coords": read_coordinates(value)} if option == "coords" else {"unit": value}
                axes[name] = replace(axes[name], **change)
        return {**self.settings, "axes": list(axes.values())}


def goal_from(options: dict[str, Any]) -> Goal:
    """Take the values of `goal_options`, but for --plan, out of a command's options.

    Raises:
        click.UsageError: both --snr and --size.
    """
    source = {key: options.pop(key) for key in SOURCE}
    along = {key: options.pop(key) for key in ("coords", "unit")}
    goal = Goal(options.pop("snr"), options.pop("size"), options.pop("kind"), options, source, along)
    if goal.snr is not None and goal.size is not None:
        raise click.UsageError("--snr and --size are both given: choose one of them.")
    return goal


def command_for(source: str, output: str, plan: Plan | None, goal: Goal) -> str:
    """The command that fits exactly this plan, in full, or for None what is best for the goal; and whatever else was
    given."""
    words = ["hmkcta", "compress", source, "-o", output]
    given: dict[str, Any] = {"snr": goal.snr, "size": goal.size, "kind": goal.kind, **goal.settings, **goal.source}
    if plan is not None:
        words += ["--organisation", format_organisation(plan.organisation), "--plan", str(plan)]
        given |= {"organisation": None, "snr": plan.snr, "size": plan.size}
    defaults = {param.name: param.default for param in click.get_current_context().command.params}
    for name, value in given.items():
        if value is not None and value != defaults.get(name):
            words += [f"--{name.replace('_', '-')}", _written(name, value)]
    for option, pairs in goal.along.items():
        words += [word for pair in pairs for word in (f"--{option}", "=".join(pair))]
    return shlex.join(words)


def _written(name: str, value: Any) -> str:
    """An option's value as it is given on the command line."""
    if name == "nan":
        return f"fill={float(value)!r}"
    if isinstance(value, list | tuple):
        return ",".join(map(str, cast("Sequence[Any]", value)))
    return repr(value) if isinstance(value, float) else str(value)


def beyond_cost(cost: int, goal: Goal, plan: str | None) -> list[str]:
    """A sentence on a --plan that takes more multiply-adds than --decode-cost."""
    most = goal.settings["decode_cost"]
    if plan is None or cost <= most:
        return []
    return [f"an element takes {multiply_adds(cost)}, more than --decode-cost {most}, which bounds what a goal "
            "chooses, not a written plan. Next: write lower ranks, or leave --plan out"]


def ordinary_cameras(goal: Goal, kind: str) -> list[str]:
    """A sentence on axes that are called as cameras of a light field are, and do not make one."""
    names: list[str] = goal.settings["axes"] or []
    at = {name.lower(): n for n, name in enumerate(names)}  # a name with a role is another
    told = goal.kind is None and kind in ("volume", "generic") and {"u", "v", "y", "x"} <= at.keys()
    if not told or max(at["u"], at["v"]) > min(at["y"], at["x"]):
        return []
    written = ",".join(f"{name}:view" if name.lower() in "uv" else name for name in names)
    return [f"u and v are read as axes of space, not as cameras, which makes it a {kind}. Next: for a light field "
            f"write --axes {written}"]
