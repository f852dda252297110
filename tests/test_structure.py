"""The shape of the code: imports point downward, files and functions stay small, importing stays cheap."""

from __future__ import annotations

import ast
import json
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
PACKAGE = ROOT / "python" / "hmkcta"

#: Modules and subpackages from the lowest layer up; an import goes to a lower layer, or stays in its subpackage.
LAYERS = (
    ("arrays", "storage"),
    ("_version", "errors", "metrics", "_native"),
    ("loopback", "support"),
    ("axes", "goals", "packing", "transform", "indexing"),
    ("neighbours", "plan", "packed"),
    ("conventions", "plan_checks", "planned"),
    ("labels",),
    ("cells", "hmkfile", "_example", "planned_size"),
    ("backends",),
    ("decode", "journal_cells", "streaming"),
    ("journal",),
    ("filesize", "model", "verbatim", "wanted"),
    ("measure", "offset"),
    ("fitting",),
    ("search",),
    ("encode",),
    ("pictures", "readers", "synthetic"),
    ("",),
    ("render", "serve"),
    ("cli",),
    ("__main__",),
)
#: The same within subpackages.
WITHIN = {
    "decode": (("scattered",), ("cells",), ("dense",)),
    "fitting": (
        ("tucker",),
        ("projection", "reassign", "subspaces"),
        ("memberships",),
        ("search",),
        ("matrix_free",),
        ("swaps",),
        ("fit", "subdivision"),
        ("run", "workset"),
        ("disjoint",),
        ("hierarchy",),
        ("measure_streamed", "pack"),
        ("hmkcta",),
    ),
    "search": (
        ("hosvd", "layout", "rate_model", "roots"),
        ("block_code", "blocks", "kernels", "rank_boxes"),
        ("values",),
        ("clusters", "judging"),
        ("coded",),
        ("engine", "stages"),
        ("second_level", "written"),
        ("find",),
    ),
    "streaming": (
        ("budget", "scratch", "steady"),
        ("collecting", "pieces"),
        ("blocks", "source"),
        ("slabbed",),
        ("streamed",),
        ("large",),
    ),
}
LAYER_OF = {name: number for number, layer in enumerate(LAYERS) for name in layer}
LAYER_WITHIN = {
    f"{package}.{name}": number
    for package, layers in WITHIN.items()
    for number, layer in enumerate(layers)
    for name in layer
}

#: Folders whose code is ours, and what each file may come to.
FOLDERS = ("python", "tests", "benchmarks", "docs", "crates")
MOST_LINES, MOST_IN_FUNCTION = 500, 60
LONG_FILES: set[str] = set()
LONG_FUNCTIONS: set[str] = set()
#: What `import hmkcta` must not load: the command line, pictures and fitting do, when they are used.
LATE = ("click", "rich", "PIL", "scipy", "wgpu", "hmkcta.fitting.fit")

LOCK_FILES = (
    "Cargo.lock",
    "uv.lock",
    "poetry.lock",
    "Pipfile.lock",
    "package-lock.json",
    "yarn.lock",
    "pnpm-lock.yaml",
)
#: A temporary folder may stand in an example; folders of somebody's machine may not.
MACHINE_PATH = re.compile(r"(?<![\w.])/(?:work|home|root|Users|mnt|scratch)/\w")


def sources(*suffixes: str) -> list[Path]:
    """Files of the project's folders, none that a build or a tool made."""
    made = {"target", "__pycache__", "node_modules"}
    return [
        path
        for folder in FOLDERS
        for path in sorted((ROOT / folder).rglob("*"))
        if path.suffix in suffixes and not made & set(path.parts)
    ]


def named(path: Path) -> str:
    """The path from the root, as it is shown."""
    return path.relative_to(ROOT).as_posix()


def tree(path: Path) -> ast.Module:
    """The file's syntax."""
    return ast.parse(path.read_text(encoding="utf-8"), named(path))


def dotted(path: Path) -> list[str]:
    """Words of the module's name below `hmkcta`, a package's being its folder's."""
    words = list(path.relative_to(PACKAGE).with_suffix("").parts)
    return words[:-1] if words[-1] == "__init__" else words


def imported(path: Path) -> Iterator[list[str]]:
    """Words below `hmkcta` of everything of ours that a module imports, wherever in it."""
    own = dotted(path)
    package = own if path.name == "__init__.py" else own[:-1]
    for statement in ast.walk(tree(path)):
        if isinstance(statement, ast.Import):
            found = [alias.name.split(".") for alias in statement.names]
        elif isinstance(statement, ast.ImportFrom):
            words = statement.module.split(".") if statement.module else []
            if statement.level:
                words = ["hmkcta", *package[: len(package) - statement.level + 1], *words]
            found = [[*words, alias.name] for alias in statement.names]
        else:
            continue
        yield from (words[1:] for words in found if words[0] == "hmkcta")


def imports(path: Path) -> Iterator[str]:
    """The first of those words; that of the package itself is empty."""
    return (words[0] if words and words[0] in LAYER_OF else "" for words in imported(path))


def test_every_module_has_a_layer() -> None:
    modules = {dotted(path)[0] for path in PACKAGE.rglob("*.py") if dotted(path)}
    assert modules <= LAYER_OF.keys(), f"give these a place in LAYERS: {sorted(modules - LAYER_OF.keys())}"
    assert set(LAYER_OF) - {"", "_native"} <= modules, "these modules of LAYERS are gone"
    assert sum(map(len, LAYERS)) == len(LAYER_OF), "a module stands in two layers"


def test_imports_point_downward() -> None:
    upward: list[str] = []
    for path in sorted(PACKAGE.rglob("*.py")):
        own = (dotted(path) or [""])[0]
        upward += [
            f"{named(path)} imports {target or 'hmkcta'}"
            for target in imports(path)
            if target != own and LAYER_OF[target] >= LAYER_OF[own]
        ]
    assert not upward


def test_imports_point_downward_within_subpackages() -> None:
    inner = {".".join(dotted(path)): path for package in WITHIN for path in (PACKAGE / package).glob("[!_]*.py")}
    assert inner.keys() == LAYER_WITHIN.keys()
    upward = [
        f"{named(path)} imports {target}"
        for name, path in sorted(inner.items())
        for target in (".".join(words[:2]) for words in imported(path))
        if target.partition(".")[0] == name.partition(".")[0] and LAYER_WITHIN.get(target, 99) >= LAYER_WITHIN[name]
    ]
    assert not upward


def test_the_import_rule_sees_imports() -> None:
    assert {"support", "cells"} <= set(imports(PACKAGE / "backends" / "native.py"))
    assert {"axes", "encode", "model"} <= set(imports(PACKAGE / "__init__.py"))
    assert ["search", "layout", "Layout"] in imported(PACKAGE / "search" / "engine.py")


def test_files_are_short() -> None:
    lengths = {named(path): len(path.read_text(encoding="utf-8").splitlines()) for path in sources(".py", ".rs")}
    assert not {name: lines for name, lines in lengths.items() if lines > MOST_LINES and name not in LONG_FILES}


def functions(path: Path) -> Iterator[tuple[str, int]]:
    """Names and lengths in lines of a file's functions, from the first statement after the docstring."""
    for node in ast.walk(tree(path)):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            body = node.body[1:] if ast.get_docstring(node, clean=False) is not None else node.body
            yield f"{named(path)}:{node.name}", (body[-1].end_lineno or 0) - body[0].lineno + 1 if body else 0


def test_functions_are_short() -> None:
    lengths = dict(entry for path in sources(".py") for entry in functions(path))
    long = {name for name, lines in lengths.items() if lines > MOST_IN_FUNCTION}
    assert not {name: lengths[name] for name in long - LONG_FUNCTIONS}
    assert long >= LONG_FUNCTIONS, "take what is short by now off LONG_FUNCTIONS"


def test_the_library_does_not_print() -> None:
    printing = [
        f"{named(path)}:{node.lineno}"
        for path in PACKAGE.rglob("*.py")
        for node in ast.walk(tree(path))
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "print"
    ]
    assert not printing


def test_no_bare_except() -> None:
    bare = [
        f"{named(path)}:{node.lineno}"
        for path in sources(".py")
        for node in ast.walk(tree(path))
        if isinstance(node, ast.ExceptHandler) and node.type is None
    ]
    assert not bare


def test_importing_loads_neither_the_command_line_nor_pictures_nor_fitting() -> None:
    program = (
        f"import sys, json; sys.path.insert(0, {str(PACKAGE.parent)!r}); import hmkcta; "
        f"sys.stdout.write(json.dumps([name for name in {LATE!r} if name in sys.modules]))"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True, timeout=60)
    assert json.loads(done.stdout) == []


@pytest.mark.parametrize("name", ["backends.find_device", "render.render", "serve.serve", "synthetic.material"])
def test_modules_of_examples_need_no_import_of_their_own(name: str) -> None:
    program = f"import sys; sys.path.insert(0, {str(PACKAGE.parent)!r}); import hmkcta; hmkcta.{name}"
    subprocess.run([sys.executable, "-c", program], check=True, timeout=60)


def test_type_checkers_are_told_of_the_annotations() -> None:
    """Without the marker (PEP 561) they take the installed package for one that has none."""
    assert (PACKAGE / "py.typed").read_bytes() == b""


@pytest.fixture(scope="module")
def tracked() -> list[Path]:
    """What git tracks, or would with the next `git add`."""
    if not (ROOT / ".git").exists():
        pytest.skip("no git checkout: an unpacked source archive has no list of files")
    listed = subprocess.run(
        ["git", "-c", f"safe.directory={ROOT}", "ls-files", "-z", "--cached", "--others", "--exclude-standard"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
        timeout=60,
    )
    return [ROOT / name for name in listed.stdout.split("\0") if name and (ROOT / name).is_file()]


def test_no_lock_files(tracked: list[Path]) -> None:
    assert not [named(path) for path in tracked if path.name in LOCK_FILES]


def test_no_paths_of_a_machine(tracked: list[Path]) -> None:
    texts = {".py", ".rs", ".md", ".toml", ".json", ".csv", ".cff", ".yml", ".yaml", ""}
    found = [
        f"{named(path)}: {hit.group()}"
        for path in tracked
        if path.suffix in texts and path.stat().st_size < 2**20
        for hit in [MACHINE_PATH.search(path.read_text(encoding="utf-8"))]
        if hit
    ]
    assert not found
