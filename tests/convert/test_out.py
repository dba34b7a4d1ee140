from __future__ import annotations

import json
import re
import shutil
import sys
import types
from collections import defaultdict
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from synchronizar.cli import main
from synchronizar.convert.pyfg_out import write_pyfg
from synchronizar.data.exported import Exported
from synchronizar.data.recording import Recording
from synchronizar.errors import InputError
from synchronizar.io.tum import read_tum, write_tum
from synchronizar.reporting.evaluate import evaluate_folder

# PyFG, read as CORA's own documentation and reader have it: what kind of line has which words.


@dataclass
class Graph:
    """What CORA makes of a file: everything in 3D, symbols of one letter and a number."""

    poses: dict[str, np.ndarray] = field(default_factory=dict)
    """4x4 of each vertex."""
    t: dict[str, float] = field(default_factory=dict)
    landmarks: dict[str, np.ndarray] = field(default_factory=dict)
    steps: dict[tuple[str, str], np.ndarray] = field(default_factory=dict)
    covariances: list[np.ndarray] = field(default_factory=list)
    ranges: list[tuple[float, str, str, float, float]] = field(default_factory=list)
    priors: dict[str, tuple[np.ndarray, np.ndarray]] = field(default_factory=dict)
    """Place and covariance of each landmark that has one."""


def rotation(x: float, y: float, z: float, w: float) -> np.ndarray:
    """The matrix of a unit quaternion, from its definition."""
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def pose_of(numbers: list[float]) -> np.ndarray:
    out = np.eye(4)
    out[:3, :3], out[:3, 3] = rotation(*numbers[3:]), numbers[:3]
    return out


def symmetric(numbers: list[float], dim: int) -> np.ndarray:
    """Column by column, each from the diagonal on."""
    out, rest = np.zeros((dim, dim)), iter(numbers)
    for i in range(dim):
        for j in range(i, dim):
            out[i, j] = out[j, i] = next(rest)
    assert next(rest, None) is None
    return out


def read_as_cora(path: Path) -> Graph:
    graph = Graph()
    lines = path.read_text().splitlines()
    assert lines[0].split()[0] in ("VERTEX_SE2", "VERTEX_SE3:QUAT", "VERTEX_XY", "VERTEX_XYZ")  # tells the dimension
    for line in lines:
        kind, *words = line.split(" ")
        if kind == "VERTEX_SE3:QUAT":
            assert re.fullmatch(r"[A-Za-z]\d+", words[1])
            assert len(words) == 9
            assert words[1] not in graph.poses
            graph.t[words[1]], graph.poses[words[1]] = float(words[0]), pose_of([float(w) for w in words[2:]])
        elif kind == "VERTEX_XYZ":
            assert re.fullmatch(r"L\d+", words[0])
            graph.landmarks[words[0]] = np.array([float(w) for w in words[1:]])
            assert len(words) == 4
        elif kind == "VERTEX_XYZ:PRIOR":
            assert words[1] in graph.landmarks
            numbers = [float(w) for w in (words[0], *words[2:])]
            graph.priors[words[1]] = np.array(numbers[1:4]), symmetric(numbers[4:], 3)
        elif kind == "EDGE_SE3:QUAT":
            assert {words[1], words[2]} <= graph.poses.keys()
            graph.steps[words[1], words[2]] = pose_of([float(w) for w in words[3:10]])
            graph.covariances.append(symmetric([float(w) for w in words[10:]], 6))
        elif kind == "EDGE_RANGE":
            assert {words[1], words[2]} <= graph.poses.keys() | graph.landmarks.keys()
            graph.ranges.append((float(words[0]), words[1], words[2], float(words[3]), float(words[4])))
            assert len(words) == 5
        else:
            raise AssertionError(f"CORA knows no {kind}")
    return graph


@pytest.fixture(scope="module")
def walk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("out") / "walk"
    options = ["--users", "3", "--seconds", "12", "--static-radios", "1", "--antennas", "2", "--late-share", "0.2"]
    options += ["--up", "y", "--seed", "4"]
    assert main(["simulate", str(folder), *options]) == 0
    assert main(["register", str(folder), "--out", str(folder.parent / "answer")]) == 0
    return folder


def converted(walk: Path, name: str, *options: str) -> Path:
    out = walk.parent / name
    assert main(["convert", str(walk), str(out), *options]) == 0
    return out


def test_cora_reads_every_range_of_a_recording_between_antennas(walk: Path) -> None:
    recording = Recording.load(walk)
    graph = read_as_cora(converted(walk, "walk.pyfg"))
    ranges = recording.ranges
    assert len(graph.ranges) == len(ranges)
    letters = {"phone0": "A", "phone1": "B", "phone2": "C", "radio0": "L"}
    names = [user.name for user in recording.users]
    written = {(round(t, 6), frozenset((a[0], b[0]))): (d, v) for t, a, b, d, v in graph.ranges}
    for n in range(len(ranges)):
        ends = frozenset(letters[names[who[n]]] for who in (ranges.a, ranges.b))
        distance, variance = written[round(float(ranges.t[n]), 6), ends]
        assert distance == pytest.approx(ranges.distance[n], abs=1e-6)
        assert variance == pytest.approx(0.01 if np.isnan(ranges.sigma[n]) else ranges.sigma[n] ** 2)


def test_surveyed_radios_are_priors_and_come_back_as_they_were(walk: Path, tmp_path: Path) -> None:
    copy = tmp_path / "surveyed"
    shutil.copytree(walk, copy)
    text = (copy / "recording.toml").read_text()
    section = re.search(r"\[users\.\"?radio0\"?\]\n", text)
    assert section is not None
    place = "position = [1.0, -2.0, 2.5]\nposition_sigma = 0.05\n"
    (copy / "recording.toml").write_text(text[: section.end()] + place + text[section.end() :])
    graph = read_as_cora(converted(copy, "surveyed.pyfg"))
    where, covariance = graph.priors["L0"]
    np.testing.assert_allclose(where, [1.0, -2.0, 2.5])
    np.testing.assert_allclose(graph.landmarks["L0"], where)
    np.testing.assert_allclose(covariance, 0.0025 * np.eye(3))
    assert not read_as_cora(converted(walk, "walk.pyfg")).priors
    assert main(["convert", str(tmp_path / "surveyed.pyfg"), str(tmp_path / "again")]) == 0
    again = next(user for user in Recording.load(tmp_path / "again").users if user.static)
    assert (again.position, again.position_sigma) == ((1.0, -2.0, 2.5), pytest.approx(0.05))


def test_a_vertex_is_the_antenna_at_the_moment_of_its_range(walk: Path) -> None:
    recording = Recording.load(walk)
    graph, ranges = read_as_cora(converted(walk, "walk.pyfg")), recording.ranges
    antennas: dict[tuple[str, float], set[int]] = defaultdict(set)
    for n in range(len(ranges)):
        for who, antenna in ((ranges.a[n], ranges.antenna_a[n]), (ranges.b[n], ranges.antenna_b[n])):
            if recording.users[who].name == "phone1":
                antennas["B", round(float(ranges.t[n]), 6)].add(int(antenna))
    track, levers = recording.tracks["phone1"], recording.users[recording.index("phone1")].levers
    for (_, t), used in list(antennas.items())[::7]:
        pose = track.at(np.array([t]), 1.0)
        expected = [pose.position[0] + rotation(*pose.quat_xyzw[0]) @ levers[antenna] for antenna in used]
        found = [p[:3, 3] for name, p in graph.poses.items() if name[0] == "B" and abs(graph.t[name] - t) < 1e-6]
        for place in expected:
            assert min(np.linalg.norm(place - other) for other in found) < 2e-4


def test_steps_lead_from_each_vertex_to_the_next_with_a_covariance_that_is_one(walk: Path) -> None:
    graph = read_as_cora(converted(walk, "walk.pyfg"))
    assert len(graph.steps) == len(graph.poses) - 3
    for (a, b), step in graph.steps.items():
        assert (a[0], int(a[1:]) + 1) == (b[0], int(b[1:]))
        np.testing.assert_allclose(graph.poses[a] @ step, graph.poses[b], atol=1e-6)
    for covariance in graph.covariances:
        assert np.linalg.eigvalsh(covariance)[0] > 0.0
        # One number for places and one for attitudes are all that CORA takes.
        assert np.ptp(np.diag(covariance)[:3]) == np.ptp(np.diag(covariance)[3:]) == 0.0


def test_with_an_answer_vertices_are_in_the_common_frame_and_leave_of_used_ranges_noise(walk: Path) -> None:
    answer = walk.parent / "answer"
    graph = read_as_cora(converted(walk, "answer.pyfg", "--answer", str(answer)))
    told = json.loads((answer / "registration.json").read_text())
    assert len(graph.ranges) == told["ranges"]["used"]
    places = {**{name: pose[:3, 3] for name, pose in graph.poses.items()}, **graph.landmarks}
    off = np.array([np.linalg.norm(places[a] - places[b]) - distance for _, a, b, distance, _ in graph.ranges])
    assert np.sqrt(np.mean(off**2)) < 0.2


def test_what_pyfg_has_of_a_recording_comes_back_from_it(walk: Path, tmp_path: Path) -> None:
    made, back = converted(walk, "walk.pyfg"), tmp_path / "back"
    assert main(["convert", str(made), str(back), "--rename", "A=phone0"]) in (0, 1)
    again, recording = Recording.load(back), Recording.load(walk)
    assert len(again.ranges) == len(recording.ranges)
    np.testing.assert_allclose(np.sort(again.ranges.distance), np.sort(recording.ranges.distance), atol=1e-6)
    moved = np.linalg.norm(np.diff(again.tracks["phone0"].position, axis=0), axis=1).sum()
    assert moved > 5.0


def test_more_devices_than_letters_are_told() -> None:
    pose = ([0.0, 1.0], np.zeros((2, 3)), [[0, 0, 0, 1]] * 2)
    many = Recording.from_arrays({f"u{k:02}": pose for k in range(51)}, [(0.5, "u00", "u01", 1.0)])
    with pytest.raises(InputError, match="letters for 50 devices"):
        write_pyfg(Path("no.pyfg"), Exported(many))


# TF


class Node:
    def __init__(self, **settings: Any) -> None:
        self.settings = settings


def check_transforms(found: dict[str, np.ndarray], walk: Path) -> None:
    """The same as `matrix` in registration.json, for all that are registered."""
    users = json.loads((walk.parent / "answer" / "registration.json").read_text())["users"]
    assert found.keys() == {f"{name}/slam" for name, user in users.items() if user["state"] == "registered"} != set()
    for child, pose in found.items():
        matrix, scale = np.array(users[child.removesuffix("/slam")]["matrix"]), users[child[:-5]]["scale"]
        np.testing.assert_allclose(pose[:3, 3], matrix[:3, 3], atol=1e-6)
        if not child.startswith("radio"):
            np.testing.assert_allclose(scale * pose[:3, :3], matrix[:3, :3], atol=1e-6)


def test_the_yaml_is_a_message_of_tf_static(walk: Path) -> None:
    yaml = pytest.importorskip("yaml", reason="PyYAML is not installed")
    message = yaml.safe_load(converted(walk, "tf.yaml", "--answer", str(walk.parent / "answer")).read_text())
    found = {}
    for transform in message["transforms"]:
        assert transform["header"] == {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": "common"}
        place, turn = transform["transform"]["translation"], transform["transform"]["rotation"]
        found[transform["child_frame_id"]] = pose_of([*(place[k] for k in "xyz"), *(turn[k] for k in "xyzw")])
    check_transforms(found, walk)


def test_the_launch_file_starts_a_publisher_for_each(walk: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    launch, actions = types.ModuleType("launch"), types.ModuleType("launch_ros.actions")
    launch.LaunchDescription = list  # type: ignore[attr-defined]
    actions.Node = Node  # type: ignore[attr-defined]
    for name, module in {
        "launch": launch,
        "launch_ros": types.ModuleType("launch_ros"),
        "launch_ros.actions": actions,
    }.items():
        monkeypatch.setitem(sys.modules, name, module)
    scope: dict[str, Any] = {}
    exec(converted(walk, "frames.launch.py", "--answer", str(walk.parent / "answer")).read_text(), scope)
    found = {}
    for node in scope["generate_launch_description"]():
        assert (node.settings["package"], node.settings["executable"]) == ("tf2_ros", "static_transform_publisher")
        words = node.settings["arguments"]
        given = dict(zip(words[::2], words[1::2], strict=True))
        assert given["--frame-id"] == "common"
        numbers = [float(given[option]) for option in ("--x", "--y", "--z", "--qx", "--qy", "--qz", "--qw")]
        found[given["--child-frame-id"]] = pose_of(numbers)
    check_transforms(found, walk)


def test_transforms_need_an_answer(walk: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["convert", str(walk), str(walk.parent / "no.yaml")]) == 2
    assert "--answer" in capsys.readouterr().err


# TUM, by evo


def test_evo_reads_the_tracks_as_they_are(walk: Path) -> None:
    file_interface = pytest.importorskip("evo.tools.file_interface", reason="evo is not installed (the test group)")
    folder = converted(walk, "tracks", "--to", "tum", "--answer", str(walk.parent / "answer"))
    assert {file.name for file in folder.iterdir()} == {f"phone{k}.tum" for k in range(3)}
    for file in folder.iterdir():
        track, own = file_interface.read_tum_trajectory_file(str(file)), read_tum(file)
        valid, details = track.check()
        assert valid, details
        np.testing.assert_allclose(track.positions_xyz, own.position)
        np.testing.assert_allclose(track.orientations_quat_wxyz[:, [1, 2, 3, 0]], own.quat_xyzw, atol=1e-9)


def test_evo_ape_finds_the_error_that_evaluate_finds(walk: Path) -> None:
    pytest.importorskip("evo", reason="evo is not installed (the test group)")
    from evo.core import metrics, sync
    from evo.tools import file_interface

    folder, truth = converted(walk, "tracks", "--to", "tum", "--answer", str(walk.parent / "answer")), walk / "truth"
    evaluation = evaluate_folder(walk, walk.parent / "answer")
    assert evaluation.reference == "phone0"
    z_up = walk.parent / "truth.tum"
    write_tum(z_up, read_tum(truth / "phone0.tum", "y"))
    reference, estimate = sync.associate_trajectories(
        file_interface.read_tum_trajectory_file(str(z_up)),
        file_interface.read_tum_trajectory_file(str(folder / "phone0.tum")),
    )
    estimate.align(reference)
    ape = metrics.APE(metrics.PoseRelation.translation_part)
    ape.process_data((reference, estimate))
    # evo turns about three axes, `evaluate` about the vertical alone: it has a little more.
    rmse = ape.get_statistic(metrics.StatisticsType.rmse)
    assert rmse <= evaluation.reference_ate <= rmse + 0.05


def test_a_recording_is_no_place_for_tracks_of_another_frame(walk: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["convert", str(walk), str(walk), "--to", "tum"]) == 2
    assert "is a recording" in capsys.readouterr().err


@pytest.mark.parametrize("said", [["--rename", "a=b"], ["--time-offset", "5"], ["--force"], ["--json"], ["--list"]])
def test_an_option_that_would_do_nothing_is_refused(
    said: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "walk" / "tracks").mkdir(parents=True)
    (tmp_path / "walk" / "ranges.csv").touch()
    assert main(["convert", str(tmp_path / "walk"), str(tmp_path / "walk.mcap"), *said]) == 2
    assert (
        capsys.readouterr().err
        == f"synchronizar: {said[0]}: does nothing here: {tmp_path / 'walk'} is a recording itself\n"
    )
    (tmp_path / "a.tum").write_text("1 0 0 0 0 0 0 1\n")
    assert main(["convert", str(tmp_path / "a.tum"), str(tmp_path / "out"), "--answer", str(tmp_path)]) == 2
    assert capsys.readouterr().err.startswith("synchronizar: --answer: does nothing here: ")
    assert [path.name for path in sorted(tmp_path.iterdir())] == ["a.tum", "walk"]
