"""The examples, and what README.md shows, run as they stand; each ends near its own truth."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from support.paths import REPOSITORY

EXAMPLES = sorted((REPOSITORY / "examples").glob("*.py"))
LARGEST_ERROR_M = 0.3


def run(*arguments: str | Path, folder: Path) -> str:
    """What a program prints; it must end well and say nothing on stderr."""
    done = subprocess.run(
        [sys.executable, *arguments], cwd=folder, capture_output=True, text=True, check=False, timeout=300
    )
    assert (done.returncode, done.stderr) == (0, "")
    return done.stdout


def readme_block() -> str:
    """The one Python block of README.md."""
    (block,) = re.findall(r"```python\n(.*?)```", (REPOSITORY / "README.md").read_text(), flags=re.DOTALL)
    return str(block)


def test_there_are_six_examples() -> None:
    assert len(EXAMPLES) == 6


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda example: example.stem)
def test_an_example_ends_near_its_truth(example: Path, tmp_path: Path) -> None:
    said = run(example, folder=tmp_path)
    error = re.search(r"^error: ([\d.]+) m\n\Z", said, flags=re.MULTILINE)
    assert error is not None
    assert float(error[1]) < LARGEST_ERROR_M
    assert "own_gtsam" in example.name or re.search(r"^(bob|second): registered", said, flags=re.MULTILINE)


def test_the_files_example_solves_a_recording_that_is_given(tmp_path: Path) -> None:
    walk = tmp_path / "walk"
    run("-m", "synchronizar", "simulate", walk, "--seed", "1", folder=tmp_path)
    assert "phone1: registered" in run(REPOSITORY / "examples" / "from_files.py", walk, folder=tmp_path)


def test_the_readme_finds_bob_where_it_says_he_should_be(tmp_path: Path) -> None:
    (tmp_path / "readme.py").write_text(readme_block())
    state, place = run("readme.py", folder=tmp_path).strip().split("\n", 1)
    assert state == "registered"
    found, true = (np.array(part.strip(" []\n").split(), dtype=float) for part in place.split("should be"))
    assert np.linalg.norm(found - true) < LARGEST_ERROR_M
