"""A recording without files: what is given as arrays, lists or tuples is what a folder with the same numbers gives."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from synchronizar.data.recording import Recording
from synchronizar.geometry import Up
from synchronizar.simulation.simulate import Scene, simulate

Tracks = dict[str, tuple[Any, Any, Any]]
SCENE = Scene(users=2, seconds=4.0, static_radios=1, antennas=1, power=True, seed=3)


def given(folder: Path) -> tuple[Tracks, dict[str, list[Any]], dict[str, dict[str, Any]]]:
    """What a saved recording's files say, read without the package."""
    tables = {file.stem: np.loadtxt(file) for file in (folder / "tracks").glob("*.tum")}
    tracks: Tracks = {name: (t[:, 0], t[:, 1:4], t[:, 4:]) for name, t in tables.items()}
    header, *rows = [line.split(",") for line in (folder / "ranges.csv").read_text().splitlines()]
    words = ("a", "b", "antenna_a", "antenna_b", "source")
    columns = {
        name: [row[k] if name in words else float(row[k]) if row[k] else None for row in rows]
        for k, name in enumerate(header)
    }
    users: dict[str, dict[str, Any]] = {"radio0": {"static": True}}
    for line in (folder / "recording.toml").read_text().splitlines():
        if line.startswith("[users"):
            name = line.split('"')[1]
        if line.startswith("antennas"):
            lever = [float(x) for x in line.split("[")[1].rstrip("]").split(",")]
            users[name] = {"antennas": {"0": lever}}
    return tracks, columns, users


@pytest.mark.parametrize("up", ["z", "y"])
def test_arrays_give_the_recording_that_files_give(tmp_path: Path, up: Up) -> None:
    simulate(Scene(**{**vars(SCENE), "up": up})).save(tmp_path)
    tracks, columns, users = given(tmp_path)
    loaded, made = Recording.load(tmp_path), Recording.from_arrays(tracks, columns, up=up, users=users)
    assert made.users == loaded.users
    for name, track in loaded.tracks.items():
        for column in ("t", "position", "quat_xyzw"):
            np.testing.assert_array_equal(getattr(made.tracks[name], column), getattr(track, column))
    for column in ("t", "a", "b", "distance", "sigma", "antenna_a", "antenna_b", "rx_power", "fp_power", "nlos"):
        np.testing.assert_array_equal(getattr(made.ranges, column), getattr(loaded.ranges, column))


T = [0.0, 1.0, 2.0]
PLACES = [(0, 0, 0), (1, 0, 0), (2, 0, 0)]
QUATS = [(0, 0, 0, 1)] * 3
WALKS: Tracks = {"a": (T, PLACES, QUATS), "b": (T, PLACES, QUATS)}


def test_lists_and_tuples_are_welcome() -> None:
    recording = Recording.from_arrays(WALKS, [(0.5, "a", "b", 1.0), [1.5, "b", "a", 2]])
    np.testing.assert_array_equal(recording.ranges.distance, [1.0, 2.0])
    np.testing.assert_array_equal(recording.ranges.a, [0, 1])


def test_quaternions_are_normalised_and_poses_sorted() -> None:
    track = Recording.from_arrays({"a": ([2.0, 1.0], [(2, 0, 0), (1, 0, 0)], [(0, 0, 0, 9), (0, 3, 0, 4)])}, []).tracks[
        "a"
    ]
    np.testing.assert_array_equal(track.t, [1.0, 2.0])
    np.testing.assert_allclose(track.quat_xyzw, [(0, 0.6, 0, 0.8), (0, 0, 0, 1)])


def test_a_failed_measurement_is_kept_and_not_used() -> None:
    ranges = Recording.from_arrays(WALKS, [(0.5, "a", "b", None), (0.6, "a", "b", 2.0)]).ranges
    assert np.isnan(ranges.distance[0])
    columns = {"t": np.array([0.5]), "a": ["a"], "b": ["b"], "range": [None], "sigma": [None], "nlos": [None]}
    assert np.isnan(Recording.from_arrays(WALKS, columns).ranges.distance[0])


def test_no_range_at_all_is_a_recording() -> None:
    assert len(Recording.from_arrays(WALKS, []).ranges) == 0


def walk(**changed: Any) -> Tracks:
    return {"a": (changed.get("t", T), changed.get("places", PLACES), changed.get("quats", QUATS)), "b": WALKS["b"]}


LEFT = {"a": {"antennas": {"left": [0, 0, 0], "right": [0, 0, 0.1]}}}
WRONG: dict[str, tuple[Callable[[], object], str]] = {
    "nobody": (lambda: Recording.from_arrays({}, []), "tracks: has no user"),
    "a track of two arrays": (
        lambda: Recording.from_arrays({"a": (T, PLACES)}, []),
        r"tracks\['a'\]: must be \(t, pos",
    ),  # type: ignore[dict-item]
    "stamps of words": (
        lambda: Recording.from_arrays(walk(t=["x", "y", "z"]), []),
        r"tracks\['a'\]\[0\]: must be an arr",
    ),
    "no stamp": (lambda: Recording.from_arrays(walk(t=[]), []), r"tracks\['a'\]\[0\]: stamps must have shape"),
    "flat positions": (
        lambda: Recording.from_arrays(walk(places=[1, 2, 3]), []),
        r"positions must have shape \(3, 3\)",
    ),
    "ragged positions": (
        lambda: Recording.from_arrays(walk(places=[(1, 2), (1, 2, 3), (1,)]), []),
        r"\[1\]: must be an",
    ),
    "quaternions of three": (
        lambda: Recording.from_arrays(walk(quats=PLACES), []),
        r"quaternions must have shape \(3, 4\)",
    ),
    "a stamp of NaN": (
        lambda: Recording.from_arrays(walk(t=[0, np.nan, 2]), []),
        r"tracks\['a'\]\[0\]\[1\]: is no stamp",
    ),
    "milliseconds since 1970": (
        lambda: Recording.from_arrays(walk(t=[1.7e12, 1.8e12, 1.9e12]), []),
        "no stamp in seconds",
    ),
    "a position of NaN": (
        lambda: Recording.from_arrays(walk(places=[(0, 0, np.nan)] * 3), []),
        r"\[1\]\[0\]: is no pos",
    ),
    "a zero quaternion": (lambda: Recording.from_arrays(walk(quats=[(0, 0, 0, 0)] * 3), []), r"\[2\]\[0\]: is no quat"),
    "an axis called x": (lambda: Recording.from_arrays(WALKS, [], up="x"), 'up: it must be "z" or "y"'),  # type: ignore[arg-type]
    "an unknown setting": (
        lambda: Recording.from_arrays(WALKS, [], users={"a": {"colour": 1}}),
        "has no setting 'colour'",
    ),
    "a user without a track": (
        lambda: Recording.from_arrays(WALKS, [], users={"c": {}}),
        r"users\['c'\]: the user has no tr",
    ),
    "a static user with a track": (
        lambda: Recording.from_arrays(WALKS, [], users={"a": {"static": True}}),
        r"tracks\['a'\]: the user is static",
    ),
    "a short row": (
        lambda: Recording.from_arrays(WALKS, [(0, "a", "b")]),
        r"ranges\[0\]: must be \(t, a, b, distance\)",
    ),
    "an unknown user": (
        lambda: Recording.from_arrays(WALKS, [(0, "a", "c", 1)]),
        r"ranges\[0\]: b is 'c': no user has that",
    ),
    "a range to oneself": (
        lambda: Recording.from_arrays(WALKS, [(0, "a", "a", 1)]),
        "cannot measure the distance to itself",
    ),
    "a distance of words": (
        lambda: Recording.from_arrays(WALKS, [(0, "a", "b", "far")]),
        "range is 'far': it must be a num",
    ),
    "a missing column": (lambda: Recording.from_arrays(WALKS, {"t": [], "a": [], "b": []}), "ranges: lacks range"),
    "an unknown column": (
        lambda: Recording.from_arrays(WALKS, {"t": [], "a": [], "b": [], "range": [], "variance": []}),
        "ranges: has no column 'variance'",
    ),
    "columns of two lengths": (
        lambda: Recording.from_arrays(WALKS, {"t": [0, 1], "a": ["a"], "b": ["b"], "range": [1]}),
        r"ranges\['a'\]: has 1 values, t has 2",
    ),
    "a negative sigma": (
        lambda: Recording.from_arrays(WALKS, {"t": [0], "a": ["a"], "b": ["b"], "range": [1], "sigma": [-1.0]}),
        "sigma is '-1.0': it must be positive",
    ),
    "an antenna that is not named": (
        lambda: Recording.from_arrays(WALKS, [(0, "a", "b", 1)], users=LEFT),
        "antenna_a is '': there are left, right",
    ),
}


@pytest.mark.parametrize("name", WRONG)
def test_what_cannot_be_meant_is_a_value_error_naming_the_place(name: str) -> None:
    call, fault = WRONG[name]
    with pytest.raises(ValueError, match=fault):
        call()
