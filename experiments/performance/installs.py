"""How long an installation takes and how large it is, and how long the package takes to start.

`python -m experiments.performance.installs FOLDER [--what wheel sdist live ...] [--n 3]`: FOLDER has one wheel for this
machine and one sdist (`python -m build --outdir FOLDER .`).

Each is installed into a new environment (venv, with pip in it) that is removed afterwards: seconds of `pip install`, MB
of the whole environment, medians of n. What pip has downloaded before it does not download again: the network is not
timed. Starts are of the wheel without extras, medians of 10, each in a process of its own: `import synchronizar`,
`synchronizar --help`, and `synchronizar check` of three walkers of half a minute, which registers them.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import tomllib
from pathlib import Path
from statistics import median
from time import perf_counter
from typing import Any

from experiments.common.results import write_table

PYPROJECT = Path(__file__).parents[2] / "pyproject.toml"
STARTS = 10


def timed(*command: str | Path, cwd: Path) -> float:
    """Wall time of a command that must end with 0 (s)."""
    began = perf_counter()
    subprocess.run([str(word) for word in command], cwd=cwd, check=True, stdout=subprocess.DEVNULL)
    return perf_counter() - began


def megabytes(folder: Path) -> float:
    """What the files of a folder take."""
    return sum(path.lstat().st_size for path in folder.rglob("*") if not path.is_dir()) / 1e6


def installed(requirement: str, folder: Path) -> tuple[Path, float]:
    """A new environment with this in it: its programs, and how long pip took (s)."""
    timed(sys.executable, "-m", "venv", folder / "venv", cwd=folder)
    programs = folder / "venv" / ("Scripts" if os.name == "nt" else "bin")
    return programs, timed(programs / "python", "-m", "pip", "install", "--quiet", requirement, cwd=folder)


def install_row(what: str, requirement: str, n: int) -> dict[str, Any]:
    """Install it so often."""
    seconds, sizes = [], []
    for _ in range(n):
        with tempfile.TemporaryDirectory() as name:
            seconds.append(installed(requirement, Path(name))[1])
            sizes.append(megabytes(Path(name)))
    return {"what": what, "n": n, "seconds": median(seconds), "MB": median(sizes)}


def start_rows(wheel: Path) -> list[dict[str, Any]]:
    """What a user waits for before anything happens."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        programs, _ = installed(str(wheel), folder)
        python, program = programs / "python", programs / "synchronizar"
        subprocess.run([program, "simulate", "walk", "--users", "3", "--seconds", "30"], cwd=folder, check=True)
        commands: dict[str, tuple[str | Path, ...]] = {
            "python -c pass": (python, "-c", "pass"),
            "import synchronizar": (python, "-c", "import synchronizar"),
            "synchronizar --help": (program, "--help"),
            "synchronizar check walk": (program, "check", "walk"),
        }
        rows = []
        for what, command in commands.items():
            timed(*command, cwd=folder)
            rows.append({"what": what, "seconds": median(timed(*command, cwd=folder) for _ in range(STARTS))})
        return rows


def main() -> None:
    """Install, start, print."""
    extras = tomllib.loads(PYPROJECT.read_text(encoding="utf-8"))["project"]["optional-dependencies"]
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--what", nargs="+", choices=["wheel", "sdist", *extras], default=["wheel", "sdist", *extras])
    parser.add_argument("--n", type=int, default=1)
    options = parser.parse_args()
    (wheel,), (sdist,) = (list(options.folder.resolve().glob(pattern)) for pattern in ("*.whl", "*.tar.gz"))
    requirements = {"wheel": str(wheel), "sdist": str(sdist), **{extra: f"{wheel}[{extra}]" for extra in extras}}
    load = os.getloadavg() if hasattr(os, "getloadavg") else None
    settings = {"wheel": wheel.name, "n": options.n, "cores": os.cpu_count(), "load": load}
    rows = [install_row(what, requirements[what], options.n) for what in options.what]
    print(write_table("installs", rows, settings))
    print(write_table("starts", start_rows(wheel), settings))
    print(settings)


if __name__ == "__main__":
    main()
