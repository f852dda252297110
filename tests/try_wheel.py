"""Install a wheel into fresh environments, with the lowest and the newest versions that it allows, and use it there.

    python tests/try_wheel.py dist                                   # the folder's wheel, by each Python found
    python tests/try_wheel.py dist --python python3.12 --extras formats --pytest tests/test_model.py

Neither Rust nor Node is on the path of these environments, and nothing is compiled for them.
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Iterator, Sequence
from email.parser import Parser
from pathlib import Path

from packaging.requirements import Requirement
from packaging.version import Version

ROOT = Path(__file__).parent.parent
MINORS = (11, 12, 13, 14)
#: What runs tests; its versions are those of development.
RUNNERS = ("pytest", "hypothesis")


def say(text: str) -> None:
    """A line of the report."""
    sys.stdout.write(f"{text}\n")
    sys.stdout.flush()


def version_of(python: str) -> str | None:
    """`3.12.1`, of a Python that starts."""
    program = "import sys; sys.stdout.write('%d.%d.%d' % sys.version_info[:3])"
    try:
        done = subprocess.run([python, "-c", program], capture_output=True, text=True, timeout=60)
    except OSError:
        return None
    return done.stdout if done.returncode == 0 else None


def find_pythons() -> dict[str, str]:
    """A Python of each minor version, on the path or among pyenv's."""
    pyenv = Path(os.environ.get("PYENV_ROOT") or Path.home() / ".pyenv") / "versions"
    found: dict[str, str] = {}
    for minor in MINORS:
        own = [str(path) for path in sorted(pyenv.glob(f"3.{minor}.*/bin/python"))]
        for python in (sys.executable, shutil.which(f"python3.{minor}"), *own):
            version = version_of(python) if python else None
            if python and version and version.startswith(f"3.{minor}."):
                found[version] = python
                break
        else:
            say(f"not tried: no Python 3.{minor} on the path or among pyenv's")
    return found


def wheel_in(folder: Path) -> Path:
    """The newest wheel of a folder that this machine can install, or the wheel that is named."""
    if folder.suffix == ".whl":
        return folder
    wheels = sorted(folder.glob("hmkcta-*.whl"), key=lambda path: path.stat().st_mtime)
    if not wheels:
        raise SystemExit(f"no wheel in {folder}: run `make wheel` first")
    return wheels[-1]


def faults(names: Sequence[str]) -> list[str]:
    """What a wheel of these files lacks, and what it should not have."""
    wanted = {
        "the kernels": r"hmkcta/_native\.(abi3\.so|pyd)", "the page": r"hmkcta/viewer_page/index\.html",
        "the page's code": r"hmkcta/viewer_page/assets/.+\.js", "the page's module": r"hmkcta/viewer_page/hmkcta\.js",
        "the module's types": r"hmkcta/viewer_page/hmkcta\.d\.ts", "the shaders": r"hmkcta/shaders/decode\.wgsl",
        "the mark of types": r"hmkcta/py\.typed", "the licence": r"hmkcta-[^/]+\.dist-info/licenses/LICENSE",
    }
    lacking = [f"lacks {what}" for what, pattern in wanted.items() if not any(re.fullmatch(pattern, n) for n in names)]
    allowed = re.compile(r"hmkcta/(?!(.*/)?(tests|__pycache__)/)|hmkcta-[^/]+\.dist-info/")
    return lacking + [f"holds {name}" for name in names if not allowed.match(name)]


def requirements(metadata: str, extras: Sequence[str], python: str) -> Iterator[Requirement]:
    """What a wheel's metadata ask for with some extras, those that its extras name among it."""
    environment = {"python_full_version": python, "python_version": ".".join(python.split(".")[:2])}
    for line in Parser().parsestr(metadata).get_all("Requires-Dist", []):
        requirement = Requirement(line)
        marker = requirement.marker
        if marker is None or any(marker.evaluate({**environment, "extra": extra}) for extra in ("", *extras)):
            if requirement.name == "hmkcta":
                yield from requirements(metadata, sorted(requirement.extras), python)
            else:
                yield requirement


def lowest(metadata: str, extras: Sequence[str], python: str) -> dict[str, str]:
    """The lowest version of each package that they allow."""
    found: dict[str, str] = {}
    for requirement in requirements(metadata, extras, python):
        bounds = [each.version for each in requirement.specifier if each.operator == ">="]
        if len(bounds) != 1:
            raise SystemExit(f"{requirement}: give it one lower bound, >=, in pyproject.toml")
        found[requirement.name] = max(found.get(requirement.name, "0"), bounds[0], key=Version)
    return found


def run(words: Sequence[str | Path], folder: Path, path: str) -> None:
    """Run a program without what would build anything, and show what it said where it fails."""
    kept = ("SYSTEMROOT", "TEMP", "TMP", "HOME", "USERPROFILE", "PIP_INDEX_URL", "PIP_CACHE_DIR", "SSL_CERT_FILE")
    env = {name: os.environ[name] for name in kept if name in os.environ} | {"PATH": path, "PYTHONUTF8": "1"}
    done = subprocess.run([str(word) for word in words], cwd=folder, env=env, text=True, encoding="utf-8",
                          stdout=subprocess.PIPE, stderr=subprocess.STDOUT, check=False)
    if done.returncode:
        raise RuntimeError(f"{' '.join(map(str, words))}\n{done.stdout.strip()}")


def attempt(wheel: Path, python: str, constraints: Sequence[str], arguments: argparse.Namespace, folder: Path) -> str:
    """Install into an environment of its own and use it; the versions that it has."""
    subprocess.run([python, "-m", "venv", folder / "venv"], check=True)
    binaries = folder / "venv" / ("Scripts" if os.name == "nt" else "bin")
    path = os.pathsep.join([str(binaries), *([rf"{os.environ['SYSTEMROOT']}\System32"] if os.name == "nt" else [])])
    (folder / "constraints.txt").write_text("\n".join(constraints), encoding="utf-8")
    extras = f"[{arguments.extras}]" if arguments.extras else ""
    install: list[str | Path] = [binaries / "python", "-m", "pip", "install", "--quiet", "--only-binary", ":all:",
                                 "--disable-pip-version-check"]
    run([*install, "--constraint", folder / "constraints.txt", f"hmkcta{extras} @ {wheel.resolve().as_uri()}"],
        folder, path)
    (folder / "use").mkdir()
    run([binaries / "python", "-I", ROOT / "tests" / "wheel_smoke.py"], folder / "use", path)
    if arguments.pytest:
        pins = (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines()
        run([*install, *(line for line in pins if line.partition("==")[0] in RUNNERS)], folder, path)
        run([binaries / "python", "-m", "pytest", "-p", "no:cacheprovider", "-o", "pythonpath=. tests",
             *arguments.pytest], ROOT, path)
    listed = subprocess.run([binaries / "python", "-m", "pip", "freeze", "--disable-pip-version-check"], text=True,
                            stdout=subprocess.PIPE, check=True).stdout
    return ", ".join(line.replace("==", " ") for line in listed.splitlines() if "==" in line)


def parsed() -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("wheel", type=Path, help="a wheel, or the folder of one")
    parser.add_argument("--python", action="append", default=[], help="a Python to try it by; may be given again")
    parser.add_argument("--ends", choices=("lowest", "newest"), nargs="+", default=["lowest", "newest"])
    parser.add_argument("--extras", default="", help="extras to install, separated by commas")
    parser.add_argument("--pytest", nargs="+", metavar="FILE", default=[], help="tests to run there as well")
    return parser.parse_args()


def main() -> int:
    """Try it everywhere; how many environments it does not work in."""
    arguments = parsed()
    wheel = wheel_in(arguments.wheel)
    with zipfile.ZipFile(wheel) as archive:
        names = archive.namelist()
        name = next(name for name in names if re.search(r"\.dist-info/METADATA$", name))
        metadata = archive.read(name).decode("utf-8")
    if faults(names):
        raise SystemExit(f"{wheel.name} {', '.join(faults(names))}")
    pythons = {version_of(each) or each: each for each in arguments.python} or find_pythons()
    failed = 0
    for version, python in pythons.items():
        bounds = lowest(metadata, [each for each in arguments.extras.split(",") if each], version)
        for end in arguments.ends:
            constraints = [f"{package}=={bound}" for package, bound in bounds.items()] if end == "lowest" else []
            with tempfile.TemporaryDirectory() as folder:
                try:
                    say(f"passed: Python {version}, {end}: "
                        f"{attempt(wheel, python, constraints, arguments, Path(folder))}")
                except (RuntimeError, subprocess.CalledProcessError) as error:
                    failed += 1
                    say(f"FAILED: Python {version}, {end}: {error}")
    if not pythons:
        say("no Python to try it by: name one by --python")
    return failed or not pythons


if __name__ == "__main__":
    sys.exit(main())
