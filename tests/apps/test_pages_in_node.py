"""The applications' modules for pages, in plain Node, beside what Python works out."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from synchronizar.apps.catch.flight import GRAVITY, Flight
from synchronizar.apps.eyes.scan import CELL_M, SIDE, seen
from synchronizar.live.stage import HAND_M, Player

TESTS = sorted((Path(__file__).parent / "js").glob("*.test.js"))


def catch_vectors() -> dict[str, Any]:
    """Flights and hands as the game has them."""
    random = np.random.default_rng(5)
    flights, hands = [], []
    for _ in range(20):
        position, velocity = random.normal(0.0, 3.0, (2, 3)).tolist()
        t = random.uniform(0.0, 2.0)
        at = Flight(100.0, tuple(position), tuple(velocity)).at(100.0 + t)
        flights.append({"flight": {"t": 100.0, "position": position, "velocity": velocity}, "t": 100.0 + t, "at": at})
        quat = random.normal(0.0, 1.0, 4)
        quat /= np.linalg.norm(quat)
        for up in "yz":
            player = Player("ann", tuple(position), tuple(quat.tolist()), up)
            hands.append({"position": position, "quat_xyzw": quat.tolist(), "up": up, "at": player.hand})
    return {"gravity": GRAVITY, "hand": HAND_M, "flights": flights, "hands": hands}


def eyes_vectors() -> dict[str, Any]:
    """Points of surfaces, and the cells that Python tells of them."""
    points = np.random.default_rng(6).uniform(-3.0, 3.0, (200, 3))
    cubes = [cube for data in seen(points) for cube in data]
    return {"cell": CELL_M, "side": SIDE, "points": points.tolist(), "seen": cubes}


@pytest.mark.skipif(shutil.which("node") is None, reason="needs node, which is not here")
@pytest.mark.parametrize("file", TESTS, ids=lambda file: file.name)
def test_in_node(file: Path) -> None:
    environment = {**os.environ, "CATCH": json.dumps(catch_vectors()), "EYES": json.dumps(eyes_vectors())}
    run = subprocess.run(
        ["node", "--test", str(file)], env=environment, capture_output=True, text=True, timeout=120, check=False
    )
    assert run.returncode == 0, run.stdout + run.stderr
