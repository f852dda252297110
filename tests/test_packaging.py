"""What others install: ranges and exact versions, the contents of a wheel, workflows that make and publish it."""

from __future__ import annotations

import json
import re
import tomllib
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from try_wheel import faults, lowest

ROOT = Path(__file__).parent.parent
PROJECT: dict[str, Any] = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
EXTRAS: dict[str, list[str]] = PROJECT["optional-dependencies"]
#: A name and one version: an address, an option or a hash is none.
PIN = re.compile(r"([A-Za-z0-9][\w.-]*)==(\d[\w.]*)")
GOOD_WHEEL = ("hmkcta/_native.abi3.so", "hmkcta/py.typed", "hmkcta/shaders/decode.wgsl",
              "hmkcta/viewer_page/index.html", "hmkcta/viewer_page/assets/index-1.js", "hmkcta/viewer_page/hmkcta.js",
              "hmkcta/viewer_page/hmkcta.d.ts", "hmkcta-0.1.0.dist-info/licenses/LICENSE")


def named(lines: list[str]) -> list[Requirement]:
    """The packages of others among requirements."""
    return [each for each in map(Requirement, lines) if each.name != "hmkcta"]


def pins() -> dict[str, str]:
    """The exact version of each package in constraints.txt."""
    lines = [line for line in (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines() if line[:1] != "#"]
    found = {line: PIN.fullmatch(line) for line in lines}
    assert all(found.values()), [line for line, pin in found.items() if not pin]
    return {canonicalize_name(pin[1]): pin[2] for pin in found.values() if pin}


def test_every_package_has_an_exact_version_for_development() -> None:
    asked = named([*PROJECT["dependencies"], *(line for lines in EXTRAS.values() for line in lines)])
    assert {canonicalize_name(each.name) for each in asked} == set(pins())
    outside = [str(each) for each in asked if not each.specifier.contains(pins()[canonicalize_name(each.name)])]
    assert not outside, "the version of constraints.txt is outside of these ranges"


@pytest.mark.parametrize("extra", ["", *(name for name in EXTRAS if name != "dev")])
def test_users_get_ranges_of_which_the_lowest_version_is_known(extra: str) -> None:
    """An exact version or none at all would keep the package out of environments, or let in what was not tried."""
    for each in named(EXTRAS[extra] if extra else PROJECT["dependencies"]):
        assert [bound.operator for bound in each.specifier if bound.operator != "<"] == [">="], str(each)


def test_the_environment_of_development_has_every_extra_that_tests_need() -> None:
    def brought(extra: str) -> set[str]:
        ours = [name for each in map(Requirement, EXTRAS[extra]) if each.name == "hmkcta" for name in each.extras]
        return {each.name for each in named(EXTRAS[extra])}.union(*map(brought, ours))

    others = {name for extra in EXTRAS if extra != "cuda" for name in brought(extra)}  # which needs a GPU
    assert brought("dev") >= others


def test_the_version_is_one() -> None:
    def found(name: str, pattern: str) -> str:
        hit = re.search(pattern, (ROOT / name).read_text(encoding="utf-8"), re.MULTILINE)
        assert hit, name
        return hit[1]

    packages = [json.loads((ROOT / "viewer" / name).read_text(encoding="utf-8"))["version"]
                for name in ("package.json", "npm/package.json")]
    assert {found("python/hmkcta/_version.py", r'^__version__ = "(.+)"'), found("CITATION.cff", r"^version: (.+)"),
            found("crates/hmkcta-kernels/Cargo.toml", r'^version = "(.+)"'), *packages,
            found("packaging/conda/recipe.yaml", r'^  version: "(.+)"')} == {PROJECT["version"]}


def test_conda_asks_for_what_pip_does() -> None:
    text = (ROOT / "packaging" / "conda" / "recipe.yaml").read_text(encoding="utf-8")
    run = re.search(r"^  run:\n((?:    - .+\n)+)", text, re.MULTILINE)
    assert run
    asked = [each for each in named(PROJECT["dependencies"]) if each.marker is None]
    assert [line.removeprefix("    - ") for line in run[1].splitlines()] == [
        f"python {PROJECT['requires-python']}", *(f"{each.name} {each.specifier}" for each in asked)]


@pytest.mark.parametrize(("names", "said"), [
    (GOOD_WHEEL, []), ((*GOOD_WHEEL, "tests/test_model.py"), ["holds tests/test_model.py"]),
    ((*GOOD_WHEEL, "hmkcta/tests/test_a.py"), ["holds hmkcta/tests/test_a.py"]),
    ([name for name in GOOD_WHEEL if "LICENSE" not in name], ["lacks the licence"]),
    ([name for name in GOOD_WHEEL if "index.html" not in name], ["lacks the page"]),
])
def test_a_wheel_holds_the_page_and_the_licence_and_no_tests(names: list[str], said: list[str]) -> None:
    assert faults(names) == said


def test_the_lowest_versions_are_those_of_the_python() -> None:
    metadata = "\n".join(["Requires-Dist: numpy>=1.26", "Requires-Dist: numpy>=2.1 ; python_full_version >= '3.13'",
                          "Requires-Dist: hmkcta[b] ; extra == 'a'", "Requires-Dist: scipy>=1.9,<2 ; extra == 'b'"])
    assert lowest(metadata, [], "3.12.1") == {"numpy": "1.26"}
    assert lowest(metadata, ["a"], "3.13.0") == {"numpy": "2.1", "scipy": "1.9"}
    with pytest.raises(SystemExit, match="give it one lower bound"):
        lowest("Requires-Dist: numpy==2.0", [], "3.12.1")


@pytest.mark.parametrize("name", ["ci.yml", "release.yml"])
def test_jobs_of_workflows_wait_for_jobs_and_take_what_these_leave(name: str) -> None:
    text = (ROOT / ".github" / "workflows" / name).read_text(encoding="utf-8")
    jobs: dict[str, Any] = import_module("yaml").safe_load(text)["jobs"]  # PyYAML comes with zarr
    there: dict[str, set[str]] = {}
    for job, content in jobs.items():
        needs = content.get("needs", [])
        before: list[str] = [needs] if isinstance(needs, str) else needs
        assert set(before) <= there.keys(), f"{job} waits for no job that is above it"
        steps = [(str(step.get("uses", "")), step.get("with", {})) for step in content["steps"]]
        there[job] = {with_["name"] for uses, with_ in steps if "upload-artifact" in uses}
        there[job] |= {name for each in before for name in there[each]}
        taken = {with_["name"] for uses, with_ in steps if "download-artifact" in uses and "name" in with_}
        patterns = [re.sub(r"\\\$\\{\\{.+?\\}\\}", ".+", re.escape(each)) for each in there[job]]
        assert not [each for each in taken if not re.fullmatch("|".join(patterns), each)], job
    files = set(re.findall(r"(?:tests|viewer)/[\w/]+\.(?:py|json)|\.ci/\w+", text))
    assert not [each for each in files if not (ROOT / each).is_file()]
