"""Whether an installed synchronizar works: a walk whose truth is known is registered by its commands.

It needs what the wheel requires and nothing else: run it with the Python that the wheel was installed for.
Where gtsam is, the walk is also registered in the order of time.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from importlib.util import find_spec
from pathlib import Path

WITHIN_M = 0.1  # three walkers of half a minute: 0.02 m in the plane where all is well


def told(folder: Path, *arguments: str) -> str:
    """What a command prints, begun in `folder`, where no source of the package is; it must end with 0."""
    run = subprocess.run(
        [sys.executable, "-m", "synchronizar", *arguments],
        cwd=folder,
        env={**os.environ, "PYTHONUTF8": "1"},
        capture_output=True,
        encoding="utf-8",
    )
    if run.returncode != 0:
        raise SystemExit(f"{' '.join(arguments)} ended with {run.returncode}: {run.stdout}{run.stderr}")
    return run.stdout


def everybody_is_registered(folder: Path, command: str) -> None:
    """By `command`, whose answer is written into a folder of its name."""
    answer = json.loads(told(folder, command, "walk", "--out", command, "--json"))
    states = {name: user["state"] for name, user in answer["users"].items()}
    if len(states) != 3 or set(states.values()) != {"registered"}:
        raise SystemExit(f"{command}: {states}")


def main() -> None:
    """Exit with 1 and a sentence where something does not work."""
    began = time.perf_counter()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        version = told(folder, "--version").strip()
        told(folder, "simulate", "walk", "--users", "3", "--seconds", "30", "--seed", "1")
        told(folder, "check", "walk")
        everybody_is_registered(folder, "register")
        error = json.loads(told(folder, "evaluate", "walk", "register", "--json"))["joint_ate_xy"]
        if not error < WITHIN_M:
            raise SystemExit(f"register is {error:.3f} m off")
        told(folder, "plot", "walk", "register", "--html")
        if find_spec("gtsam") is not None:
            everybody_is_registered(folder, "replay")
    print(f"{version} works: {error:.3f} m off in the plane; {time.perf_counter() - began:.1f} s")


if __name__ == "__main__":
    main()
