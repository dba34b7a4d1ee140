"""The modules that the pages are made of, in plain Node."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
from dataclasses import asdict
from pathlib import Path

import pytest
from live import pose_vectors

from synchronizar.parameters import SmoothingParameters

TESTS = sorted((Path(__file__).parent / "js").glob("*.test.js"))


@pytest.mark.skipif(shutil.which("node") is None, reason="needs node, which is not here")
@pytest.mark.parametrize("file", TESTS, ids=lambda file: file.name)
def test_in_node(file: Path) -> None:
    environment = {**os.environ, "SMOOTHING": json.dumps(asdict(SmoothingParameters()))}
    run = subprocess.run(
        ["node", "--test", str(file)], env=environment, capture_output=True, text=True, timeout=120, check=False
    )
    assert run.returncode == 0, run.stdout + run.stderr


def test_the_vectors_of_poses_are_what_python_writes() -> None:
    assert json.loads(json.dumps(pose_vectors.vectors())) == json.loads(pose_vectors.VECTORS.read_text())
