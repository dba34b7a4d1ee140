from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from synchronizar.data.recording import Recording
from synchronizar.errors import InputError
from synchronizar.estimation.incremental.engine import Engine
from synchronizar.estimation.incremental.replay import in_time
from synchronizar.simulation.simulate import Scene, simulate

SCENE = Scene(users=2, seconds=14.0, rate_hz=8.0, seed=1, antennas=1, static_radios=1)


def feed(engine: Engine, recording: Recording, begin: float, end: float) -> list[str]:
    """What came in a stretch of time, a look each tenth of a second."""
    names, ranges, events = [user.name for user in recording.users], recording.ranges, []
    looked = begin
    for t, user, row in in_time(recording):
        if not begin <= t < end:
            continue
        if user < 0:
            a, b = names[ranges.a[row]], names[ranges.b[row]]
            antennas = {"antenna_a": float(ranges.antenna_a[row]), "antenna_b": float(ranges.antenna_b[row])}
            engine.add_range(t, a, b, float(ranges.distance[row]), **antennas)
            if t >= looked + 0.1:
                events += engine.advance(t)
                looked = t
        else:
            track = recording.tracks[names[user]]
            engine.add_pose(names[user], t, track.position[row], track.quat_xyzw[row])
    return events


@pytest.mark.parametrize("cut", [0.5, 4.0, 10.0])
def test_who_is_saved_and_loaded_goes_on_as_if_nothing_had_happened(cut: float, tmp_path: Path) -> None:
    recording = simulate(SCENE).recording
    whole = Engine(recording.users, "phone0")
    feed(whole, recording, 0.0, cut)
    whole.save(tmp_path / "state.npz")
    loaded = Engine.load(tmp_path / "state.npz")
    for u in range(len(recording.users)):
        assert loaded.state(u) is whole.state(u)
    for engine in (whole, loaded):
        feed(engine, recording, cut, np.inf)
    assert loaded.memory.known == whole.memory.known
    assert loaded.memory.since == whole.memory.since
    users = list(whole.registration().users.values())
    for u in range(1, len(recording.users)):
        ours, theirs = loaded.frame(u), whole.frame(u)
        assert ours is not None
        assert theirs is not None
        covariance = users[u].covariance
        assert covariance is not None
        sigma = np.sqrt(np.diag(covariance)[:3])
        assert (np.abs(ours.translation - theirs.translation) < 0.5 * sigma).all()


def test_what_is_written_is_read_to_the_last_bit(tmp_path: Path) -> None:
    recording = simulate(SCENE).recording
    engine = Engine(recording.users, "phone0")
    feed(engine, recording, 0.0, np.inf)
    engine.save(tmp_path / "state.npz")
    loaded = Engine.load(tmp_path / "state.npz")
    assert loaded.users == tuple(replace(u, antennas=dict(u.antennas)) for u in engine.users)
    for ours, theirs in zip(loaded.stream.pose_tables(), engine.stream.pose_tables(), strict=True):
        np.testing.assert_array_equal(ours, theirs)
    np.testing.assert_array_equal(loaded.stream.range_table(), engine.stream.range_table())
    first = [checkpoint.t for checkpoint in loaded.memory.checkpoints]
    # To load is to solve once more, which is a checkpoint of its own.
    assert first[: len(engine.memory.checkpoints)] == [c.t for c in engine.memory.checkpoints]


@pytest.mark.parametrize("content", [b"", b"no archive", b"PK\x03\x04 cut off"])
def test_a_file_that_is_no_saved_state_is_told(content: bytes, tmp_path: Path) -> None:
    file = tmp_path / "state.npz"
    file.write_bytes(content)
    with pytest.raises(InputError, match=r"state\.npz.*no saved state"):
        Engine.load(file)


def test_an_archive_of_something_else_is_told(tmp_path: Path) -> None:
    file = tmp_path / "state.npz"
    np.savez(file, header=np.array('{"format": 99}'))
    with pytest.raises(InputError, match="no saved state"):
        Engine.load(file)
    with pytest.raises(InputError, match="No such file"):
        Engine.load(tmp_path / "nothing.npz")
