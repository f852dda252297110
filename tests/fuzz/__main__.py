"""The command line: `python -m fuzz`."""

from __future__ import annotations

import os
import sys
import tempfile
from collections import Counter
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import click
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from .campaign import Bounds, Campaign, Finding, saved
from .readers import bundled, python_reader, viewer_reader

Result = tuple[dict[str, Finding], Counter[str]]


def one(seed: int, count: int, bundle: Path | None, bounds: Bounds, told: Callable[[], None]) -> Result:
    """One share of the mutants, with readers of its own."""
    readers = {"Python": python_reader(int(bounds.mebibytes))}
    if bundle is not None:
        readers["TypeScript"] = viewer_reader(bundle)
    campaign = Campaign(readers, seed, bounds)
    try:
        campaign.run(count, told)
    finally:
        for reader in readers.values():
            reader.close()
    return campaign.findings, campaign.verdicts


@click.command(context_settings={"show_default": True})
@click.option("--count", type=click.IntRange(1), default=200_000, help="Mutants to try.")
@click.option("--seed", type=int, default=0, help="What they follow from, with --jobs.")
@click.option("--jobs", type=click.IntRange(1), default=os.cpu_count() or 1, help="Pairs of readers at a time.")
@click.option("--seconds", type=float, default=1.0, help="Of the processor, that a reader may take for a mutant.")
@click.option("--mebibytes", type=float, default=256.0, help="Memory that a reader may take for a mutant.")
@click.option("--output", type=click.Path(path_type=Path), default=Path("fuzz-output"), help="Folder of findings.")
@click.option("--python-only", is_flag=True, help="Leave the TypeScript reader out.")
def main(count: int, seed: int, jobs: int, seconds: float, mebibytes: float, output: Path, python_only: bool) -> None:
    """Try mutants of valid files on both readers; 1 is the exit code if one does what it must not."""
    bounds, jobs = Bounds(seconds, mebibytes), min(jobs, count)
    findings, verdicts = dict[str, Finding](), Counter[str]()
    bars = (TextColumn("fuzzing"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn(), TextColumn("left:"),
            TimeRemainingColumn())
    with tempfile.TemporaryDirectory() as folder, Progress(*bars) as progress:
        bundle = None if python_only else bundled(Path(folder))
        if bundle is None and not python_only:
            raise click.ClickException("the viewer's reader cannot be bundled: make page; or give --python-only")
        task = progress.add_task("", total=count)
        shares = [count // jobs + (job < count % jobs) for job in range(jobs)]
        with ThreadPoolExecutor(jobs) as pool:  # what takes time are the readers' processes
            running = [pool.submit(one, seed + 1_000_003 * job, share, bundle, bounds, lambda: progress.advance(task))
                       for job, share in enumerate(shares)]
        for future in running:
            found, said = future.result()
            findings.update({what: each for what, each in found.items() if what not in findings})
            verdicts.update(said)
    _report(findings, verdicts, output)


def _report(findings: dict[str, Finding], verdicts: Counter[str], output: Path) -> None:
    click.echo(f"{verdicts.total()} mutants, {verdicts['ok']} of them taken, {len(verdicts)} different verdicts")
    for path, finding in zip(saved(findings, output) if findings else [], findings.values(), strict=True):
        click.echo(f"{path}: {finding.what} [{finding.change}]")
    sys.exit(1 if findings else 0)


if __name__ == "__main__":
    main()
