"""What the documents show is so: snippets run, commands parse, links lead somewhere, the table is the measured one."""

from __future__ import annotations

import re
import shlex
from importlib import import_module
from pathlib import Path
from typing import Any

import click
import numpy as np
import pytest
from benchmarks.rate_distortion import OURS, measure, read, write
from benchmarks.rate_distortion import markdown as as_markdown

import hmkcta
from hmkcta.axes import name_axes, parse_organisation, separate
from hmkcta.cli import main
from hmkcta.plan import parse_plan

ROOT = Path(__file__).parent.parent
DOCUMENTS = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").glob("*.md")])
#: What the plans of the guide's table are read for.
MODES = (("light", "rgb"), ("view",), ("y",), ("x",))
#: Names of sources in prose (`program.py` is made by a test), and of what is in the package, in sources in backquotes.
SUFFIXES = (".rs", ".py", ".pyi", ".ts", ".wgsl")
FILE_NAMES = re.compile(r"(?<![\w.*/{}-])((?:\.?/)?(?:[\w-]+/)*[\w-]+(?:\.[\w-]+)*\.(?:rs|pyi?|ts|wgsl))(?![\w\"'])")
MADE = "program.py"
PACKAGE_NAMES, QUOTED_NAMES = re.compile(r"(?<![\w./\"])(hmkcta(?:\.[A-Za-z_]\w*)+)"), re.compile(r"`(hmkcta[.\w]+)`")
#: The viewer's module and its types.
NO_MODULES = ("hmkcta.js", "hmkcta.d.ts")
#: Folders that hold nobody's own sources.
OTHERS = {"node_modules", "target", "viewer_page", "dist"}


def shown(path: Path) -> str:
    """The name of a document, for test ids."""
    return path.name


def fenced(path: Path, language: str) -> list[str]:
    """The fenced blocks of a language, in order."""
    return re.findall(rf"^```{language}\n(.*?)^```", path.read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE)


def commands() -> list[str]:
    """Every `hmkcta ..` line of a shell or indented block of the documents, and of the commands' own help."""
    text = "\n".join(path.read_text(encoding="utf-8") for path in DOCUMENTS)
    lines = re.findall(r"^(?: {4})?(hmkcta [a-z].*)$", text, re.MULTILINE)
    examples = [example for command in main.commands.values() for example in getattr(command, "examples", ())]
    return list(dict.fromkeys([line.partition("  #")[0].strip() for line in lines] + examples))


def sources(*suffixes: str) -> list[Path]:
    """The sources with these endings, of the folders that are the project's."""
    folders = ("benchmarks", "crates", "docs", "python", "tests", "viewer")
    paths = (path for folder in folders for path in (ROOT / folder).rglob("*") if path.suffix in suffixes)
    return sorted(path for path in paths if not OTHERS & set(path.relative_to(ROOT).parts))


def is_there(name: str) -> bool:
    """Whether a dotted name leads to a module or to something in one."""
    found: Any = hmkcta
    for depth, part in enumerate(parts := name.split(".")[1:], start=1):
        if not hasattr(found, part):
            try:
                import_module(".".join(["hmkcta", *parts[:depth]]))
            except ImportError:
                return False
        found = getattr(found, part)
    return True


@pytest.mark.parametrize("path", DOCUMENTS, ids=shown)
def test_python_runs(path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    together: dict[str, object] = {}
    for number, snippet in enumerate(fenced(path, "python"), start=1):
        exec(compile(snippet, f"{path.name}, snippet {number}", "exec"), together)


def test_the_documents_show_python_and_commands() -> None:
    assert fenced(ROOT / "README.md", "python")
    assert {line.split()[1] for line in commands()} == set(main.commands)


@pytest.mark.parametrize("line", commands())
def test_commands_parse(line: str) -> None:
    name, *words = shlex.split(line)[1:]
    command = main.commands[name]
    params = command.make_context(name, words, parent=click.Context(main)).params
    if params.get("plan"):
        written = params["organisation"]
        axes = name_axes([8] * len(params["axes"]), params["axes"]) if params["axes"] else ()
        modes = parse_organisation(written, axes) if written else separate(axes) or MODES
        parse_plan(params["plan"], modes)


def test_plans_of_the_table_parse() -> None:
    plans = re.findall(r"^\| `(R.*?)` \|", (ROOT / "docs" / "guide.md").read_text(encoding="utf-8"), re.MULTILINE)
    assert len(plans) >= 5
    for plan in plans:
        assert str(parse_plan(plan, MODES)).startswith(plan[:2])


@pytest.mark.parametrize("path", DOCUMENTS, ids=shown)
def test_links_lead_somewhere(path: Path) -> None:
    links = re.findall(r"\]\(([^)#\s]+)\)", path.read_text(encoding="utf-8"))
    assert not [link for link in links if "://" not in link and not (path.parent / link).exists()]


def test_files_named_in_documents_and_sources_exist() -> None:
    """With or without their folders; what stands in quotes may be made by a test."""
    files = {f"/{path.relative_to(ROOT).as_posix()}" for path in sources(*SUFFIXES)}
    missing = [f"{path.relative_to(ROOT)}: {name}" for path in [*DOCUMENTS, *sources(".rs", ".py", ".ts", ".wgsl")]
               for name in FILE_NAMES.findall(path.read_text(encoding="utf-8")) if name != MADE
               and not any(file.endswith(f"/{name.removeprefix('./')}") for file in files)]
    assert not missing


def test_names_of_the_package_exist() -> None:
    """Every dotted name in documents, docstrings and comments leads to a module, or to what is in one."""
    searched = [(path, PACKAGE_NAMES) for path in DOCUMENTS]
    searched += [(path, QUOTED_NAMES) for path in sources(".rs", ".py", ".ts", ".wgsl")]
    missing = [f"{path.relative_to(ROOT)}: {name}" for path, pattern in searched
               for name in pattern.findall(path.read_text(encoding="utf-8"))
               if name not in NO_MODULES and not is_there(name)]
    assert not missing


def test_names_in_the_notation_exist() -> None:
    """Every Python name of the notation's tables is a name in the package's sources."""
    sources = "\n".join(path.read_text(encoding="utf-8") for path in (ROOT / "python" / "hmkcta").rglob("*.py"))
    text = (ROOT / "docs" / "notation.md").read_text(encoding="utf-8")
    rows = [line.split("|") for line in text.splitlines() if line.startswith("| ")]
    cells = [row[3] for row in rows if len(row) > 4 and "---" not in row[1]]
    quoted = [code for cell in cells for code in re.findall(r"`([^`/]+)`", cell)]
    names = {word for code in quoted for word in re.findall(r"[A-Za-z_]+", code)}
    assert names
    assert not [name for name in sorted(names) if not re.search(rf"\b{name}\b", sources)]


def test_the_readme_shows_the_measured_table() -> None:
    rows = read()
    assert as_markdown(rows) in (ROOT / "README.md").read_text(encoding="utf-8")
    assert all(row.bytes <= row.budget for row in rows)


def test_the_benchmark_measures(tmp_path: Path) -> None:
    """On a small array: all methods within the budget, and back from the CSV as written."""
    y, x = np.mgrid[:24, :20]
    values = np.stack([np.sin(0.3 * y + 0.1 * t) + 0.2 * np.cos(0.4 * x * (1 + 0.1 * t)) for t in range(6)])
    rows = list(measure("waves", values.astype(np.float32), [30], 9000, threads=1))
    assert rows[0].method == OURS
    assert all(0 < row.bytes <= row.budget for row in rows)
    write(rows, tmp_path / "rows.csv")
    assert read(tmp_path / "rows.csv") == rows
    assert as_markdown(rows).count("\n") == 2
