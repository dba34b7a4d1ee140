from __future__ import annotations

from pathlib import Path

from experiments.performance.bench import batch_row, rigid_row
from synchronizar.simulation.scene import Scene
from synchronizar.simulation.simulate import simulate


def test_a_rigid_row_tells_every_stage() -> None:
    row = rigid_row(2, 40)
    assert (row["users"], row["ranges"]) == (2, 40)
    assert 0.0 < row["solve"] < row["register"]
    assert row["initialise + solve"] == row["initialise"] + row["solve"]


def test_a_batch_row_is_of_people_or_of_a_recording(tmp_path: Path) -> None:
    simulate(Scene(users=2, seconds=4.0)).save(tmp_path / "walk")
    row = batch_row(tmp_path / "walk")
    assert row["recording"] == "walk"
    assert 0.0 < row["initialise s"] + row["solve s"] <= row["wall s"]
    assert row["in yardsticks"] > 0.0
